"""A measurement campaign: simulated, measured, written, truth apart.

Its study file says no more than a real laboratory would know.
"""

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import chain
from pathlib import Path

import numpy as np
import yaml

from drake_exo.contact.strap import Design
from drake_exo.errors import InputError, check_count, check_type, path_of
from drake_exo.files.opensim import write_table
from drake_exo.files.output import Progress, read_json, write_json
from drake_exo.jobs.engine import Ended, Job, Processes, run_jobs
from drake_exo.measurement.settings import Filter
from drake_exo.measurement.trial import Trial
from drake_exo.model.segments import LEG_JOINTS
from drake_exo.virtual_laboratory.instruments import (
    CONFIGURATIONS,
    MARKER_RATE_HZ,
    PLATES,
    Clocks,
    Faults,
    Laboratory,
    MatDesign,
    draw_faults,
    drawn_clocks,
    empty_plate_levels,
    marker_set,
    slides,
    study_markers,
    write_scans,
)
from drake_exo.virtual_laboratory.plan import (
    Friction,
    Planner,
    Posture,
    Reference,
    RisePlan,
)
from drake_exo.virtual_laboratory.simulation import RATE_HZ, simulate
from drake_exo.virtual_laboratory.truth import (
    DISTURBANCES,
    KINDS,
    STANDING_COP_M,
    WIDE,
    Truth,
    checked,
    draw_truth,
    truth_table,
    wearing,
    write_parameters,
)

# Standard deviation of each signal as it reaches a phase: markers slide on
# skin, the foot's do not.
_NOISE = {
    "angle_deg": 0.5,
    "velocity_deg_s": 4.0,
    "foot_m": 0.001,
    "foot_pitch_deg": 0.3,
    "force_n": 3.0,
    "cop_m": 0.0005,
}
_FORCE_NOISE = {"moment_nm": 5.0, "exo_moment_nm": 0.3, "energy_j": 1.0}


class _Whole(yaml.Dumper):
    """Writes a value wherever it stands, never a sign for an equal one."""

    def ignore_aliases(self, data: object) -> bool:
        return True


def write_yaml(path: Path, title: str, study: dict) -> None:
    """Write a study file under a line of comment."""
    look = {"sort_keys": False, "default_flow_style": None, "width": 78}
    text = yaml.dump(study, Dumper=_Whole, **look)
    path.write_text(f"# {title}\n{text}", encoding="utf-8")


def _model(truth: Truth) -> str | dict:
    """What the study says of it: of cuffs that are built otherwise, each."""
    model, places = truth.model, {}
    for name, own in truth.design.cuffs.items():
        if not own.removed and (own.across_m or own.along_m):
            x, z = model.cuffs[name]
            place = [round(x + own.across_m, 4), round(z + own.along_m, 4)]
            places[name] = {"at_m": place}
    if isinstance(model.kind, str) and not places:
        return model.kind
    known = model.assembly
    cuffs = {
        name: {k: v for k, v in vars(cuff).items() if v} | places.get(name, {})
        for name, cuff in known.cuffs.items()
    }
    return {"device": {"weld": dict(known.device.weld)}, "cuffs": cuffs}


def device_section(
    joints: Iterable[str], friction: Friction, found: Iterable[float]
) -> dict:
    """Joint -> its friction, as far as a bench found it.

    Args:
        joints: as the study calls them.
        friction: of them.
        found: share of each.
    """
    rows = zip(joints, friction.viscous, friction.coulomb, found, strict=True)
    return {
        joint: {
            "viscous_nm_s": share * viscous,
            "coulomb_nm": share * dry,
            "coulomb_speed_rad_s": friction.speed,
        }
        for joint, viscous, dry, share in rows
    }


def phase_sections(legs: int = 1) -> dict:
    """Settings of the three phases; nominal values are not the truth.

    Weights of the second: a device that moves nobody has the moments of its
    own friction; with the share of it that is unknown they are right to
    0.1 N m.

    The third tracks no kinematics but ends. Those of the person are a degree
    off: what skin does there that the error model does not know would set the
    device swinging. Contact energy weighs as little as in the second: at a
    tenth of a joule the person bends by degrees to spare the cuffs what they
    bear.

    Args:
        legs: that move on their own, each with soles of its own.
    """

    def sphere():
        modulus = {"nominal": 5e6, "lower": 1e6, "upper": 2e7}
        return {
            "modulus_n_m2": {k: v / legs for k, v in modulus.items()},
            "dissipation_s_m": {"nominal": 2.0, "lower": 0.0, "upper": 5.0},
            "x_m": {"below": 0.03, "above": 0.03},
            "z_m": {"below": 0.015, "above": 0.015},
        }

    own = {"exo_angle_deg": 0.1, "exo_velocity_deg_s": 1.0}
    forces = _FORCE_NOISE | {"exo_moment_nm": 0.1}
    return {
        "foot_ground": {
            "law": "simbody",
            "heel": sphere(),
            "toe": sphere(),
            "noise": _NOISE,
            "solver": {"nodes_per_second": 100.0},
        },
        "interaction": {"noise": {**_NOISE, **own, **forces}},
        "prediction": {"noise": {**_NOISE, **_FORCE_NOISE, "angle_deg": 1.0}},
    }


_MODES = ("passive", "assisted")
_TRIALS, _MOVEMENTS = 5, 3
# The last movement of the latest trials: three to calibrate, six to predict.
_USED = {
    ("passive", "pelvis"): (4, 5),
    ("passive", "legs"): (5,),
    ("assisted", "pelvis"): (3, 4, 5),
    ("assisted", "legs"): (3, 4, 5),
}
NUM_USED = sum(map(len, _USED.values()))
_HELP = (0.0, 0.2, 0.2)
_STANDING_S = 2.0
# A trial begins when the chair is felt no more, a little later so that the
# filter does not smear the chair's force into it.
_CHAIR_GONE_N = 2.0
_AFTER_CHAIR_S = 0.08
_AFTER_RISE_S = 0.1
# As plates show it.
_SEEN_NOISE_N, _SEEN_OFFSET_N, _SEEN_GONE_N = 0.5, 5.0, 10.0
_SEEN_END_S = 0.05


@dataclass(frozen=True)
class Repetition:
    """One sit-to-stand of the protocol.

    Attributes:
        mode: "passive" or "assisted".
        configuration: of the mats, "pelvis" or "legs".
        trial, movement: from 1.
    """

    mode: str
    configuration: str
    trial: int
    movement: int = _MOVEMENTS

    @property
    def name(self) -> str:
        """Of its files."""
        return f"{self.mode}_{self.configuration}_{self.trial}_{self.movement}"

    @property
    def is_used(self) -> bool:
        """Whether the study uses it."""
        used = _USED[self.mode, self.configuration]
        return self.movement == _MOVEMENTS and self.trial in used

    @property
    def key(self) -> list[int]:
        """Of its random numbers."""
        return [
            _MODES.index(self.mode),
            list(CONFIGURATIONS).index(self.configuration),
            self.trial,
            self.movement,
        ]


def protocol(count: int | None = None, full: bool = False) -> list[Repetition]:
    """Movements of a campaign: those that the study uses come first.

    Args:
        count: that many of those in use; all nine by default.
        full: also the ones that the paper recorded and did not use, 60 in
            all.

    Raises:
        InputError: a count that is not from one to nine.
    """
    count = NUM_USED if count is None else count
    if count not in range(1, NUM_USED + 1):
        raise InputError(f"trials is {count!r:.60}; give 1 to {NUM_USED}")
    everything = [
        Repetition(mode, configuration, trial, movement)
        for mode in _MODES
        for configuration in CONFIGURATIONS
        for trial in range(1, _TRIALS + 1)
        for movement in range(1, _MOVEMENTS + 1)
    ]
    used = [m for m in everything if m.is_used][: int(count)]
    rest = [m for m in everything if not m.is_used]
    return used + rest if full else used


def write_campaign(
    folder: str | Path,
    seed: int,
    disturbances: Iterable[str] = tuple(DISTURBANCES),
    trials: int | None = None,
    *,
    full: bool = False,
    files: str = "c3d",
    truth: str = "wide",
    processes: int = 1,
    design: Design | None = None,
    assisted: bool = False,
) -> Path:
    """Simulate a subject and write what a laboratory would hand over.

    Args:
        folder: made if it is not there; receives study.yaml, standing and
            trial files, and truth/, which no calibration reads.
        seed: same seed, same bytes.
        disturbances: names of `DISTURBANCES` that act.
        trials: number of movements in use, the three of calibration first;
            nine by default.
        full: also record what the study does not use, as the paper did.
        files: "c3d" or "opensim" (.trc and .mot).
        truth: "wide", or "near" to what a calibration begins with.
        processes: how many work at once; they do not change the result.
        design: a design, built and worn by the same subject, who does the same.
        assisted: leave out movements in the passive device.

    Returns:
        The study file.

    Raises:
        InputError: unknown disturbance, kind of files or truth, a seed or
            number of trials or processes that cannot be, a design of another
            device, or a folder that holds a study already.

    >>> import tempfile
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     write_campaign(folder, seed=1, trials=1).name
    'study.yaml'
    """
    folder = path_of(folder, "folder")
    movements = protocol(trials, full)
    check_count(seed, 0, "seed")
    check_count(processes, 1, "processes")
    if design is not None:
        check_type(design, Design, "design")
    if assisted:
        movements = [m for m in movements if m.mode == "assisted"]
    if truth not in KINDS:
        raise InputError(f"truth is {truth!r}; give one of {', '.join(KINDS)}")
    if (folder / "study.yaml").exists():
        raise InputError(
            f"{folder}: holds a study already; choose another folder"
        )
    active = checked(disturbances) - (set() if truth == "wide" else set(WIDE))
    job = Campaign(folder, seed, active, files, truth, design)
    progress = Progress(
        "virtual laboratory", len(movements), interval_seconds=2.0
    )
    mats = job.prepare(progress)
    entries = job.record_all(
        {m.name: m for m in movements}, processes, progress
    )
    used = [entries[m.name] for m in movements if m.is_used]
    path = folder / "study.yaml"
    title = "A virtual subject in the exoskeleton stands up."
    write_yaml(path, title, job.study(mats, used))
    return path


def read_about(folder: str | Path) -> dict:
    """What `write_campaign` was told, as its arguments by name.

    Args:
        folder: that it wrote.

    Raises:
        InputError: it holds no campaign of the virtual laboratory, or one
            that wears a design, or of two legs.
    """
    remedy = "give the study.yaml of 'drake-exo lab'"
    path = Path(folder) / "truth" / "truth.json"
    about = read_json(path, remedy)
    if isinstance(about, dict):
        for key, how in (("design", "--design"), ("left_share", "--model")):
            if key in about:
                raise InputError(
                    f"{path}: is of 'drake-exo lab {how}', with which no "
                    f"design can be built; {remedy} without {how}"
                )
    try:
        return {
            "seed": int(about["seed"]),
            "disturbances": checked(map(str, about["disturbances"])),
            "truth": str(about["truth"]),
        }
    except (KeyError, TypeError, ValueError) as error:
        raise InputError(f"{path}: is damaged; {remedy}") from error


def record(job: "Session", movement) -> dict:
    """`Session.record` in another process."""
    return job.record(movement)


class Session:
    """A subject in a laboratory, whose movements stand for themselves.

    Args:
        seed: of all random numbers.
        truth: the subject.
        planner: of its movements.
        mats: on it.
        about: what files of the truth say of the session.
        equipment: of `Laboratory`, what is not drawn here, by name.
    """

    first_key = 0  # of its random numbers, which no other kind has

    def __init__(
        self,
        seed: int,
        truth: Truth,
        planner: Planner,
        mats: Sequence[MatDesign],
        about: dict,
        **equipment,
    ):
        self.seed, self.truth, self.planner = seed, truth, planner
        self.mats, self.about = mats, about
        human, rng = truth.model.assembly.human, self.rng(1)
        markers = marker_set(truth.human, human.sides)
        self.laboratory = Laboratory(
            model=truth.model,
            markers=markers,
            slide=slides(markers, rng),
            offsets={place: empty_plate_levels(rng) for place in PLATES},
            **equipment,
        )

    def rng(self, what: int, *key: int) -> np.random.Generator:
        """Random numbers of their own for everything that is drawn."""
        return np.random.default_rng([self.seed, self.first_key + what, *key])

    def standing(self) -> Reference:
        """The plan of quiet standing."""
        return self.planner.standing(_STANDING_S, STANDING_COP_M)

    def prepare(self, progress: Progress | None = None) -> dict[str, dict]:
        """Quiet standing, empty plates, body scan and true parameters.

        Returns:
            The section `mats` of the study.
        """
        laboratory, rng = self.laboratory, self.rng(2)
        folder, truth = laboratory.folder, laboratory.folder / "truth"
        truth.mkdir(parents=True, exist_ok=True)
        plan = self.standing()
        standing = simulate("standing", self.truth, plan, progress=progress)
        laboratory.record_motion(standing, rng, hidden=False)
        laboratory.record_empty(rng)
        write_happened(truth, standing)
        write_parameters(truth, self.truth, self.about)
        return write_scans(folder, self.truth.model, standing.q[-1], self.mats)

    def recorded(
        self,
        model: str | dict,
        plates: Mapping[str, int],
        cutoff_hz: float = 6.0,
    ) -> dict:
        """Sections of the study from `subject` to `markers`.

        Args:
            model: the section of that name.
            plates: foot or chair -> number.
            cutoff_hz: of the filter.
        """
        human, laboratory = self.truth.human, self.laboratory
        active, section = laboratory.disturbances, {}
        if laboratory.files == "c3d":
            axes = {"forward": "x", "up": "z"}
            section |= {"marker_axes": axes, "force_axes": axes}
        if "gaps" in active:
            section["fill_gaps_s"] = 0.2
        if "plate_drift" in active:
            section["remove_plate_drift"] = True
        if "clocks" in active:
            section["estimate_encoder_delay"] = True
            section["estimate_pressure_delay"] = True
        return {
            "subject": {
                "name": "virtual_subject",
                "mass_kg": round(human.mass_kg, 3),
                "height_m": round(human.height_m, 4),
                "sex": "male",
            },
            "model": model,
            "gravity_m_s2": self.truth.model.gravity_m_s2,
            "filter": {"cutoff_hz": cutoff_hz, "order": 4},
            "laboratory": section,
            "standing": {
                **laboratory.motion_files("standing"),
                "plates": plates,
                **laboratory.empty_files,
                "start_s": 0.5,
            },
            "scaling": {"lengths": "markers", "trunk_com": "table"},
            "markers": study_markers(),
        }

    def record_all(
        self, movements: Mapping, processes: int, progress: Progress
    ) -> dict[str, dict]:
        """Name -> what the study says of each movement, which `record` takes.

        Args:
            movements: by name.
            processes: that work at once.
            progress: told of every movement.
        """
        entries: dict[str, dict] = {}
        if processes == 1:
            for name, movement in movements.items():
                entries[name] = self.record(movement, progress, len(entries))
            return entries

        def end(row: Ended) -> None:
            entries[row.name] = row.result()
            progress.update(row.name, len(entries))

        jobs = [
            Job(name, f"{__name__}:record", {"job": self, "movement": movement})
            for name, movement in movements.items()
        ]
        with Processes(processes) as pool:
            run_jobs(jobs, pool, end)
        return {name: entries[name] for name in movements}

    def varied(self, vary: Callable, plan, *key: int):
        """A plan as it is done this time: `vary` has random numbers by key."""
        if "variation" not in self.laboratory.disturbances:
            return plan
        return vary(plan, self.rng(3, *key))

    def measure(
        self,
        happened: Trial,
        rng: np.random.Generator,
        mats: Sequence[MatDesign],
        clocks: Clocks | None = None,
        with_moments: bool = False,
    ) -> None:
        """Write what instruments say of a movement, and what is true.

        Args:
            happened: the movement.
            rng: of its measurement.
            mats: that are used.
            clocks: of the device and the mats; drawn if None.
            with_moments: whether the device tells its moments.
        """
        laboratory = self.laboratory
        laboratory.record_motion(happened, rng)
        if happened.coordinates.device:
            clocks = clocks or drawn_clocks(rng, laboratory.disturbances)
            laboratory.record_device(happened, clocks, with_moments, rng)
            laboratory.record_pressure(happened, mats, clocks.mats)
        write_happened(laboratory.folder / "truth", happened, clocks)


class Campaign(Session):
    """A session of one who stands up in the shipped exoskeleton.

    Arguments are those of `write_campaign`, checked.
    """

    def __init__(
        self,
        folder: Path,
        seed: int,
        active: frozenset[str],
        files: str,
        kind: str,
        design: Design | None = None,
    ):
        self.seed = seed
        truth = draw_truth(self.rng(0), active, kind)
        # Faults are those of the laboratory, whatever is built.
        faults = (
            Faults()
            if kind == "near"
            else draw_faults(self.rng(5), active, truth.cuffs)
        )
        about = {
            "seed": seed,
            "truth": kind,
            "disturbances": active,
            "faults": faults,
        }
        if design is not None:
            truth = wearing(truth, design)
        if truth.design != Design():
            about["design"] = truth.design
        every = chain(*CONFIGURATIONS.values())
        super().__init__(
            seed,
            truth,
            Planner(truth.model.rigid.tree, truth.contact),
            [mat for mat in every if mat.cuff in truth.cuffs],
            about,
            folder=folder,
            files=files,
            disturbances=active,
            faults=faults,
        )

    def record(
        self,
        movement: Repetition,
        progress: Progress | None = None,
        done: int | None = None,
    ) -> dict:
        """Simulate a movement, write its files; what the study says of it."""
        laboratory = self.laboratory
        plan = self.varied(vary, RisePlan(), *movement.key)
        seat = self.planner.seat(plan)
        assisted = movement.mode == "assisted"
        happened = simulate(
            movement.name,
            self.truth,
            self.planner.rise(plan, seat),
            seat,
            _HELP if assisted else (),
            (plan.quiet_s + plan.lean_s + _AFTER_CHAIR_S, _rise_end(plan)),
            progress,
            done,
        )
        rng = self.rng(4, *movement.key)
        clocks = drawn_clocks(rng, laboratory.disturbances)
        usual = CONFIGURATIONS[movement.configuration]
        mats = [mat for mat in usual if mat in self.mats]
        self.measure(happened, rng, mats, clocks, assisted)
        rng = self.rng(6, *movement.key)
        noisy = laboratory.faults.noisy_windows
        start, end = _window(happened, plan, rng if noisy else None)
        return self.entry(movement, mats, start, end)

    def entry(
        self,
        movement: Repetition,
        mats: Sequence[MatDesign],
        start_s: float,
        end_s: float,
    ) -> dict:
        """What the study says of a movement and its used part.

        In the assisting device it is predicted, and has moments.
        """
        laboratory, name = self.laboratory, movement.name
        assisted = movement.mode == "assisted"
        pressure = {"file": f"{name}.asc", "mats": [mat.name for mat in mats]}
        trial = {
            "name": name,
            "use": "prediction" if assisted else "calibration",
            **laboratory.motion_files(name),
            "plates": PLATES,
            **laboratory.empty_files,
            "encoders": laboratory.device_file(name, "encoders"),
            "pressure": [pressure] if mats else [],
            "start_s": start_s,
            "end_s": end_s,
        }
        if assisted:
            trial["exo_moments"] = laboratory.device_file(name, "moments")
        return trial

    def study(self, mats: dict, entries: list[dict]) -> dict:
        """The study file; friction of the device as far as a bench found it.

        Args:
            mats: the section of that name.
            entries: the section `trials`.
        """
        friction = device_section(
            LEG_JOINTS,
            self.truth.friction,
            self.laboratory.faults.friction_share,
        )
        return {
            **self.recorded(_model(self.truth), PLATES),
            "device": {
                "encoder_legs": "both",
                "moment_legs": "both",
                **friction,
            },
            "mats": mats,
            "trials": entries,
            **phase_sections(),
        }


def write_happened(
    folder: Path, movement: Trial, clocks: Clocks | None = None
) -> None:
    """Write what truly happened in a movement, and its clocks' lags."""
    name, step = movement.name, round(RATE_HZ / MARKER_RATE_HZ)
    write_table(
        folder / f"{name}.sto",
        truth_table(movement, step),
        f"{name}: what truly happened",
    )
    if clocks is not None:
        write_json(folder / f"{name}_clocks.json", clocks)


def vary(plan: RisePlan, rng: np.random.Generator) -> RisePlan:
    """Another repetition of the same movement by the same subject."""

    def turned(posture: Posture, spread: Posture) -> Posture:
        return Posture(
            *(
                float(getattr(posture, k) + rng.uniform(-1.0, 1.0) * s)
                for k, s in vars(spread).items()
            )
        )

    return replace(
        plan,
        seated=turned(plan.seated, Posture(2.0, 2.0, 3.0)),
        leant=turned(plan.leant, Posture(2.0, 2.0, 4.0)),
        lean_s=float(plan.lean_s * rng.uniform(0.9, 1.15)),
        rise_s=float(rng.uniform(1.2, 1.7)),
        cop_m=float(plan.cop_m + rng.uniform(-0.01, 0.01)),
    )


def _rise_end(plan: RisePlan) -> float:
    return plan.duration - plan.stand_s + _AFTER_RISE_S


def after_chair(
    movement: Trial, force: np.ndarray, gone: float = _CHAIR_GONE_N
) -> float:
    """When the chair is felt no more, filters' tails included [s].

    Args:
        movement: what happened.
        force: vertical one of the chair, as it is seen.
        gone: at which there is none [N].
    """
    last = np.flatnonzero(force > gone)[-1]
    return float(movement.times[last] + _AFTER_CHAIR_S)


def _window(
    movement: Trial, plan: RisePlan, rng: np.random.Generator | None
) -> tuple[float, float]:
    """Used part of a trial, to the marker frame [s].

    Args:
        movement: what happened.
        plan: of it.
        rng: for those who cut by what plates show: the chair's force comes
            filtered, with noise and an offset, and its end is where it falls
            below a threshold that is above both; None for the truth.
    """
    force, gone = movement.chair.force_z, _CHAIR_GONE_N
    end = _rise_end(plan)
    if rng is not None:
        noise = rng.normal(0.0, _SEEN_NOISE_N, len(force))
        offset = rng.uniform(-_SEEN_OFFSET_N, _SEEN_OFFSET_N)
        force = Filter().smooth(force + noise, RATE_HZ, "chair") + offset
        gone = _SEEN_GONE_N
        end += rng.uniform(-_SEEN_END_S, _SEEN_END_S)
    start = after_chair(movement, force, gone)
    return to_frames(start, end)


def to_frames(*times: float) -> tuple[float, ...]:
    """The nearest times of marker frames [s]."""
    frames = np.round(np.array(times) * MARKER_RATE_HZ)
    return tuple((frames / MARKER_RATE_HZ).tolist())
