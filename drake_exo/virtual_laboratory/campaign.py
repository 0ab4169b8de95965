"""A virtual campaign: movements are simulated, measured and written as files.

The study file holds only what a real laboratory would know; the truth is in a
folder of its own.
"""

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
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

# Noise of each signal as a phase tracks it: markers slide on skin, but those of
# the foot do not.
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
    """YAML dumper that repeats equal values instead of aliasing them."""

    def ignore_aliases(self, data: object) -> bool:
        return True


def write_yaml(path: Path, title: str, study: dict) -> None:
    """Write a study file, with the title as a comment in its first line."""
    look = {"sort_keys": False, "default_flow_style": None, "width": 78}
    text = yaml.dump(study, Dumper=_Whole, **look)
    path.write_text(f"# {title}\n{text}", encoding="utf-8")


def _model(truth: Truth) -> str | dict:
    """The study's section `model`; all cuffs are listed if one has moved."""
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
    """Joint -> its friction in a study, as identified on a bench.

    Args:
        joints: names in the study.
        friction: true friction of the joints.
        found: share of each joint's friction that the bench found.
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
    """The study's sections of Phases A to C; nominal values are not the truth.

    Phase B: moments of a passive device are those of its friction; since the
    unknown share of friction is estimated, they are right to 0.1 N m.

    Phase C tracks no kinematics except end states. The person's have a standard
    deviation of one degree, since skin movement that the error model lacks
    would otherwise set the device swinging. Contact energy has as little weight
    as in Phase B: with 0.1 J as its size, the person bends by degrees to unload
    the cuffs.

    Args:
        legs: number of soles of their own, among which the modulus is shared.
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
# (mode, mats) -> trials whose last movement the study uses: three calibrate
# (passive), six are predicted (assisted).
_USED = {
    ("passive", "pelvis"): (4, 5),
    ("passive", "legs"): (5,),
    ("assisted", "pelvis"): (3, 4, 5),
    ("assisted", "legs"): (3, 4, 5),
}
NUM_USED = sum(map(len, _USED.values()))
_HELP = (0.0, 0.2, 0.2)
_STANDING_S = 2.0
# A trial begins a little after the chair's force has gone, so that the filter
# does not smear that force into it.
_CHAIR_GONE_N = 2.0
_AFTER_CHAIR_S = 0.08
_AFTER_RISE_S = 0.1
# As plates show it: noise, largest offset, threshold; largest error of the end.
_SEEN_NOISE_N, _SEEN_OFFSET_N, _SEEN_GONE_N = 0.5, 5.0, 10.0
_SEEN_END_S = 0.05


@dataclass(frozen=True)
class Repetition:
    """One sit-to-stand of the protocol.

    Attributes:
        mode: "passive" or "assisted".
        configuration: where the mats are, "pelvis" or "legs".
        trial, movement: numbers from 1; a trial has three movements.
    """

    mode: str
    configuration: str
    trial: int
    movement: int = _MOVEMENTS

    @property
    def name(self) -> str:
        """Name of its files and of the study's trial."""
        return f"{self.mode}_{self.configuration}_{self.trial}_{self.movement}"

    @property
    def is_used(self) -> bool:
        """Whether the study uses it."""
        used = _USED[self.mode, self.configuration]
        return self.movement == _MOVEMENTS and self.trial in used

    @property
    def key(self) -> list[int]:
        """Key of its random numbers."""
        return [
            _MODES.index(self.mode),
            list(CONFIGURATIONS).index(self.configuration),
            self.trial,
            self.movement,
        ]


def protocol(count: int | None = None, full: bool = False) -> list[Repetition]:
    """Movements of a campaign; those that the study uses come first.

    Args:
        count: number of movements in use, 1 to 9; all nine by default.
        full: add those that the paper recorded but did not use, 60 in all.

    Raises:
        InputError: `count` is not from 1 to 9.
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
    """Simulate a subject and write the files of a gait laboratory.

    Args:
        folder: made if it is not there; receives study.yaml, standing and
            trial files, and truth/, which no calibration reads.
        seed: of all random numbers; the same seed gives the same bytes.
        disturbances: names of `DISTURBANCES` that act.
        trials: number of movements in use, the three of calibration first;
            nine by default.
        full: also record what the study does not use, as the paper did.
        files: "c3d" or "opensim" (.trc and .mot).
        truth: "wide", or "near" the nominal values a calibration starts from.
        processes: number of parallel ones; no influence on the result.
        design: device to be worn; subject and movements stay the same.
        assisted: leave out movements in the passive device.

    Returns:
        The study file.

    Raises:
        InputError: unknown disturbance, kind of files or truth; seed or number
            of trials or processes out of range; a design of another device; or
            the folder holds a study already.

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
    title = "A virtual subject in the exoskeleton stands up."
    return job.write({m.name: m for m in movements}, processes, title)


def read_about(folder: str | Path) -> dict:
    """Seed, disturbances and truth of a campaign, for `write_campaign`.

    Args:
        folder: folder that `write_campaign` wrote.

    Raises:
        InputError: it holds no campaign of the virtual laboratory, or one with
            a design or of two legs.
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
    """`Session.record` as a function, for jobs in other processes."""
    return job.record(movement)


class Session:
    """A subject in a laboratory; each movement is independent of the others.

    Args:
        seed: of all random numbers.
        truth: the subject.
        planner: plans its movements.
        mats: all pressure mats.
        about: entries for the files of the truth that describe the session.
        equipment: fields of `Laboratory` that are not drawn here.
    """

    first_key = 0  # offset of its random numbers' keys; subclasses differ

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
        """A generator of its own for each kind of draw, by number and key."""
        return np.random.default_rng([self.seed, self.first_key + what, *key])

    def standing(self) -> Trial:
        """The plan of quiet standing."""
        return self.planner.standing(_STANDING_S, STANDING_COP_M)

    def prepare(self, tell: Callable | None = None) -> dict[str, dict]:
        """Write quiet standing, empty plates, body scan and true parameters.

        Returns:
            The study's section `mats`.
        """
        laboratory, rng = self.laboratory, self.rng(2)
        folder, truth = laboratory.folder, laboratory.folder / "truth"
        truth.mkdir(parents=True, exist_ok=True)
        plan = self.standing()
        standing = simulate("standing", self.truth, plan, tell=tell)
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
        """Sections of the study on subject, model and laboratory.

        Args:
            model: the section `model`.
            plates: foot or chair -> number of its force plate.
            cutoff_hz: of the low-pass filter.
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

    def write(self, movements: Mapping, processes: int, title: str) -> Path:
        """Write all files of the session; the study file.

        Args:
            movements: name -> argument of `record`.
            processes: number that run in parallel.
            title: of the study.
        """
        progress = Progress(
            "virtual laboratory", len(movements), interval_seconds=2.0
        )
        mats = self.prepare(progress.update)
        entries: dict[str, dict | None] = {}

        def end(row: Ended) -> None:
            entries[row.name] = row.result()
            progress.update(row.name, len(entries))

        if processes == 1:
            for name, movement in movements.items():
                tell = partial(progress.update, done=len(entries))
                entries[name] = self.record(movement, tell)
        else:
            jobs = [
                Job(name, f"{__name__}:record", {"job": self, "movement": m})
                for name, m in movements.items()
            ]
            with Processes(processes) as pool:
                run_jobs(jobs, pool, end)
        used = [e for e in map(entries.get, movements) if e is not None]
        path = self.laboratory.folder / "study.yaml"
        write_yaml(path, title, self.study(mats, used))
        return path

    def varied(self, vary: Callable, plan, *key: int):
        """The plan, varied by `vary` if the disturbance "variation" acts."""
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
        """Write a movement as instruments record it, and the truth.

        Args:
            happened: the true movement.
            rng: of the measurement.
            mats: mats in use.
            clocks: lags of device and mats; drawn if None.
            with_moments: whether the device records its joint moments.
        """
        laboratory = self.laboratory
        laboratory.record_motion(happened, rng)
        if happened.coordinates.device:
            clocks = clocks or drawn_clocks(rng, laboratory.disturbances)
            laboratory.record_device(happened, clocks, with_moments, rng)
            laboratory.record_pressure(happened, mats, clocks.mats)
        write_happened(laboratory.folder / "truth", happened, clocks)


class Campaign(Session):
    """A session of a subject who stands up in the shipped exoskeleton.

    Arguments are those of `write_campaign`, already checked.
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
        # Drawn before the design is worn: faults do not depend on it.
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
        self, movement: Repetition, tell: Callable | None = None
    ) -> dict | None:
        """Simulate a movement and write its files; its entry in `trials`.

        None if the study leaves the movement out.
        """
        laboratory = self.laboratory
        plan = self.varied(vary, RisePlan(), *movement.key)
        seat = self.planner.seat(plan)
        assisted = movement.mode == "assisted"
        happened = simulate(
            movement.name,
            self.truth,
            self.planner.movement(plan, seat),
            seat,
            _HELP if assisted else (),
            (plan.quiet_s + plan.lean_s + _AFTER_CHAIR_S, _rise_end(plan)),
            tell,
        )
        rng = self.rng(4, *movement.key)
        clocks = drawn_clocks(rng, laboratory.disturbances)
        usual = CONFIGURATIONS[movement.configuration]
        mats = [mat for mat in usual if mat in self.mats]
        self.measure(happened, rng, mats, clocks, assisted)
        rng = self.rng(6, *movement.key)
        noisy = laboratory.faults.noisy_windows
        start, end = _window(happened, plan, rng if noisy else None)
        if not movement.is_used:
            return None
        return self.entry(movement, mats, start, end)

    def entry(
        self,
        movement: Repetition,
        mats: Sequence[MatDesign],
        start_s: float,
        end_s: float,
    ) -> dict:
        """Entry of a movement in the study's `trials`.

        Movements with assistance are predicted, and have recorded moments.
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
        """The contents of study.yaml, with friction as found on a bench.

        Args:
            mats: the section `mats`.
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
    """Write the true movement, and the lags of its clocks."""
    name, step = movement.name, round(RATE_HZ / MARKER_RATE_HZ)
    write_table(
        folder / f"{name}.sto",
        truth_table(movement, step),
        f"{name}: what truly happened",
    )
    if clocks is not None:
        write_json(folder / f"{name}_clocks.json", clocks)


def vary(plan: RisePlan, rng: np.random.Generator) -> RisePlan:
    """The plan of another repetition, with random posture and timing."""

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
    """Time when the chair's force has gone, with the filter's tail [s].

    Args:
        movement: the true movement.
        force: vertical force of the chair, true or as seen [N].
        gone: threshold below which there is no force [N].
    """
    last = np.flatnonzero(force > gone)[-1]
    return float(movement.times[last] + _AFTER_CHAIR_S)


def _window(
    movement: Trial, plan: RisePlan, rng: np.random.Generator | None
) -> tuple[float, float]:
    """Start and end of a trial's used part, at marker frames [s].

    Args:
        movement: the true movement.
        plan: its plan.
        rng: for a window found from what plates show: the chair's force is
            filtered, with noise and an offset, and ends where it falls below
            a threshold above both; None: from the true force.
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
    """Times rounded to marker frames [s]."""
    frames = np.round(np.array(times) * MARKER_RATE_HZ)
    return tuple((frames / MARKER_RATE_HZ).tolist())
