"""How many mistakes of a laboratory the plausibility checks catch.

For each seed a campaign of the virtual laboratory is judged as it is (all nine
trials: every failing check is a false alarm), and then once with each of the
mistakes below, planted in its study file or its files (the three trials for
calibration). A mistake is caught if an error message (exit code 2) or a failing
check (exit code 3) ends the command, and named if it is the expected one.

    python benchmarks/plausibility.py --seeds 1:6 --truth near wide
        [--data DIR] [--mistakes NAME ...] [--json]

Limits were chosen on seeds 1 to 6 of both kinds and on the recordings of
tests/studies.
"""

import argparse
import contextlib
import copy
import functools
import io
import json
import sys
import tempfile
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import yaml

import drake_exo as dx
from drake_exo.errors import InputError
from drake_exo.files.opensim import write_table, write_trc
from drake_exo.files.output import Progress
from drake_exo.files.tables import (
    MarkerData,
    PlateRecording,
    Table,
    read_csv_table,
    write_csv_table,
)
from drake_exo.measurement import mats, recording

# A campaign's files are read once, not once for each mistake.
recording.read_c3d = functools.cache(recording.read_c3d)
mats.read_novel_asc = functools.cache(mats.read_novel_asc)
JOINTS = ("ankle", "knee", "hip")
LEFT, RIGHT, CHAIR = 1, 2, 3


@dataclass
class Plant:
    """A campaign in which a mistake is planted.

    Attributes:
        campaign: folder of its files, which stay as they are.
        scratch: folder of the changed files.
        study: contents of the study file.
        seed: chooses the joint with the mistake.
    """

    campaign: Path
    scratch: Path
    study: dict
    seed: int

    @property
    def joint(self) -> str:
        """The device's joint with the mistake."""
        return f"exo_{JOINTS[self.seed % len(JOINTS)]}"

    @property
    def trial(self) -> dict:
        """The trial whose file has the mistake."""
        return self.study["trials"][1 % len(self.study["trials"])]

    def alone(self) -> None:
        """Leave only that trial in the study."""
        self.study["trials"] = [self.trial]

    def laboratory(self, **changes) -> None:
        """Change the study's laboratory."""
        self.alone()
        self.study["laboratory"].update(changes)

    def encoders(self, change: Callable[[Table], Table]) -> None:
        """Rewrite the encoders of all trials."""
        for trial in self.study["trials"]:
            table = change(read_csv_table(self.campaign / trial["encoders"]))
            path = self.scratch / trial["encoders"]
            write_csv_table(path, table, ["deg"] * len(table.names))
            trial["encoders"] = str(path)

    def forces(
        self,
        change: Callable[[np.ndarray, PlateRecording], PlateRecording],
        until_s: float = np.inf,
    ) -> None:
        """Rewrite the force plates of the trial, as a .mot file.

        Args:
            change: makes another plate of time and a plate.
            until_s: where the file ends.
        """
        self.alone()
        file = recording.read_c3d(self.campaign / self.trial["forces"])
        names, columns = [], []
        for plate in file.plates.values():
            p = change(file.plate_time, plate)
            for kind, values in (
                ("force_{}_v", p.force),
                ("force_{}_p", p.point),
                ("torque_{}_", p.torque),
            ):
                label = f"ground_{kind.format(p.number)}"
                names += [f"{label}{axis}" for axis in "xyz"]
                columns.append(values)
        rows = file.plate_time <= until_s
        time, values = file.plate_time[rows], np.hstack(columns)[rows]
        path = self.scratch / f"{self.trial['name']}_forces.mot"
        write_table(path, Table(time, tuple(names), values))
        self.trial["forces"] = str(path)

    def markers(self, change: Callable[[MarkerData], MarkerData]) -> None:
        """Rewrite the markers of the trial, as a .trc file."""
        self.alone()
        data = recording.read_c3d(self.campaign / self.trial["markers"]).markers
        path = self.scratch / f"{self.trial['name']}.trc"
        write_trc(path, change(data))
        self.trial["markers"] = str(path)


def marker_axes(p: Plant) -> None:
    """The markers' axes turned round."""
    p.laboratory(marker_axes={"forward": "-x", "up": "z"})


def force_axes(p: Plant) -> None:
    """The plates' axes turned round."""
    p.laboratory(force_axes={"forward": "-x", "up": "z"})


def all_axes(p: Plant) -> None:
    """Both turned round."""
    marker_axes(p)
    force_axes(p)


def obliquely(p: Plant) -> None:
    """The subject faces 30° to the left of what the study says."""
    axes = {"forward": "x", "up": "z", "facing_deg": -30.0}
    p.laboratory(marker_axes=axes, force_axes=axes)


def _of_joint(table: Table, names, change) -> Table:
    values = table.values.copy()
    for name in names:
        i = table.names.index(name)
        values[:, i] = change(values[:, i])
    return replace(table, values=values)


def encoder_signs(p: Plant) -> None:
    """All encoders count the other way."""
    p.encoders(lambda t: replace(t, values=-t.values))


def encoder_sign(p: Plant) -> None:
    """One encoder counts the other way."""
    p.encoders(lambda t: _of_joint(t, [p.joint], np.negative))


def encoder_offset(p: Plant) -> None:
    """One encoder reads 15 degrees too much."""
    p.encoders(lambda t: _of_joint(t, [p.joint], lambda x: x + np.deg2rad(15)))


def encoder_offsets(p: Plant) -> None:
    """All encoders read 15 degrees too much."""
    p.encoders(lambda t: replace(t, values=t.values + np.deg2rad(15.0)))


def encoder_columns(p: Plant) -> None:
    """Columns of knee and hip exchanged."""

    def change(table: Table) -> Table:
        a, b = (table.names.index(f"exo_{j}") for j in ("knee", "hip"))
        values = table.values.copy()
        values[:, [a, b]] = values[:, [b, a]]
        return replace(table, values=values)

    p.encoders(change)


def encoder_file(p: Plant) -> None:
    """A trial names the encoders of another trial of the study."""
    p.trial["encoders"] = p.study["trials"][0]["encoders"]


def encoder_files(p: Plant) -> None:
    """Two trials have each other's encoders."""
    first, second = p.study["trials"][:2]
    first["encoders"], second["encoders"] = (
        second["encoders"],
        first["encoders"],
    )


def force_files(p: Plant) -> None:
    """Two trials have each other's forces."""
    first, second = p.study["trials"][-2:]
    first["forces"], second["forces"] = second["forces"], first["forces"]


def encoder_stranger(p: Plant) -> None:
    """A trial has the encoders of one that is not in the study.

    Only two trials are left, either of which may have the wrong file.
    """
    first, second, third = p.study["trials"][:3]
    second["encoders"] = third["encoders"]
    p.study["trials"] = [first, second]


def cop_unit(p: Plant) -> None:
    """Centres of pressure in millimetres."""
    p.forces(lambda _, x: replace(x, point=1e3 * x.point))


def plates_exchanged(p: Plant) -> None:
    """Left and right plate exchanged."""
    p.alone()
    p.trial["plates"] |= {"left": RIGHT, "right": LEFT}


def mass(p: Plant) -> None:
    """80 instead of 60 kg."""
    p.alone()
    p.study["subject"]["mass_kg"] *= 80.0 / 60.0


def forces_end(p: Plant) -> None:
    """The force file ends in the middle of the rise."""
    start, end = p.trial.pop("start_s"), p.trial.pop("end_s")
    p.trial["rise"] = 1
    p.forces(lambda _, x: x, until_s=0.5 * (start + end))


def forces_end_early(p: Plant) -> None:
    """The same, where the study gives the part that is used."""
    until = 0.5 * (p.trial["start_s"] + p.trial["end_s"])
    p.forces(lambda _, x: x, until_s=until)


def chair_filler(p: Plant) -> None:
    """The chair's channel: zero, then 565 N."""

    def change(time, plate):
        if plate.number != CHAIR:
            return plate
        force = np.zeros_like(plate.force)
        force[time > 0.5 * time[-1], 2] = 565.0
        return replace(plate, force=force)

    p.forces(change)


def one_leg(p: Plant) -> None:
    """One leg bears 74 % of the weight."""

    def change(_, plate):
        share = {LEFT: 0.74 / 0.5, RIGHT: 0.26 / 0.5}.get(plate.number, 1.0)
        return replace(
            plate, force=share * plate.force, torque=share * plate.torque
        )

    p.forces(change)


def feet_apart(p: Plant) -> None:
    """Feet 145 mm apart fore and aft."""
    half = 0.0725
    names = ("CAL", "MT1", "MT5", "TOE", "SHK", "MAL", "THI", "KNE", "TROC")

    def markers(data):
        points = data.positions.copy()
        for i, name in enumerate(data.names):
            if name[2:5] in names or name[3:6] in names or name[2:] in names:
                points[:, i, 0] += half if name.startswith("L_") else -half
        return replace(data, positions=points)

    def forces(_, plate):
        dx = {LEFT: half, RIGHT: -half}.get(plate.number, 0.0)
        point = plate.point + np.array([dx, 0.0, 0.0])
        return replace(plate, point=point)

    p.forces(forces)
    p.markers(markers)


def kilonewtons(p: Plant) -> None:
    """Forces in kN."""
    p.forces(
        lambda _, x: replace(x, force=1e-3 * x.force, torque=1e-3 * x.torque)
    )


def pounds(p: Plant) -> None:
    """Forces in pounds."""
    lbf = 1.0 / 4.448
    p.forces(
        lambda _, x: replace(x, force=lbf * x.force, torque=lbf * x.torque)
    )


def plate_sign(p: Plant) -> None:
    """Fore-aft force of the left plate counts the other way."""

    def change(_, plate):
        x = -1.0 if plate.number == LEFT else 1.0
        return replace(plate, force=plate.force * [x, 1.0, 1.0])

    p.forces(change)


def plate_gain(p: Plant) -> None:
    """The left plate reads 1.2 times what it bears."""

    def change(_, plate):
        gain = 1.2 if plate.number == LEFT else 1.0
        force, torque = gain * plate.force, gain * plate.torque
        return replace(plate, force=force, torque=torque)

    p.forces(change)


def floor(p: Plant) -> None:
    """Markers 3 cm higher than in standing."""
    up = np.array([0.0, 0.0, 0.03])
    p.markers(lambda data: replace(data, positions=data.positions + up))


def marker_off(p: Plant) -> None:
    """A marker of the foot is 11 cm off for three frames."""
    middle = 0.5 * (p.trial["start_s"] + p.trial["end_s"])

    def change(data):
        points = data.positions.copy()
        at = np.searchsorted(data.time, middle)
        points[at : at + 3, data.names.index("L_MT5"), 0] += 0.11
        return replace(data, positions=points)

    p.markers(change)


def unloaded(p: Plant) -> None:
    """The chair's plate, which is unloaded, is named as that of both feet."""
    p.alone()
    p.trial["plates"] = {"both": CHAIR}


def standing_unloaded(p: Plant) -> None:
    """The same in the standing trial."""
    p.study["standing"]["plates"] = {"both": CHAIR}


def millimetres(p: Plant) -> None:
    """Markers in millimetres in a file that says metres."""
    p.markers(lambda data: replace(data, positions=1e3 * data.positions))


# Mistake -> names of checks of which one should fail, or "input" for an error
# that ends the command.
MISTAKES: dict[Callable[[Plant], None], tuple[str, ...]] = {
    marker_axes: ("knee_range", "input"),
    force_axes: ("plate_sides", "cop_across", "cop_along"),
    all_axes: ("knee_range",),
    obliquely: ("facing",),
    encoder_signs: ("encoder_sign",),
    encoder_sign: ("encoder_sign",),
    encoder_offset: ("encoder_offset",),
    encoder_offsets: ("encoder_offset",),
    encoder_columns: ("encoder_joints",),
    encoder_file: ("encoder_file",),
    encoder_files: (
        *("encoder_file", "encoder_swap", "encoder_motion"),
        "encoder_stranger",
    ),
    force_files: ("force_file", "force_swap"),
    encoder_stranger: ("encoder_stranger", "encoder_motion"),
    cop_unit: ("cop_unit",),
    plates_exchanged: ("plate_sides",),
    mass: ("mass",),
    forces_end: ("end", "input"),
    forces_end_early: ("input",),
    chair_filler: ("flat_channel",),
    one_leg: ("leg_share",),
    feet_apart: ("feet_apart",),
    kilonewtons: ("input",),
    pounds: ("newton",),
    plate_sign: ("shear_sign",),
    plate_gain: ("mean_weight",),
    floor: ("floor",),
    marker_off: ("marker_leap",),
    unloaded: ("input",),
    standing_unloaded: ("input",),
    millimetres: ("input",),
}


def judge(study: dict, folder: Path, root: Path) -> dict[str, str]:
    """Failing check -> its first sentence; "input" for an error message."""
    path = folder / "study.yaml"
    path.write_text(yaml.safe_dump(study, sort_keys=False), encoding="utf-8")
    try:
        with contextlib.redirect_stdout(io.StringIO()):
            checks = dx.read_study(path, root).plausibility()
    except InputError as error:
        return {"input": str(error)}
    failed = [c for c in checks if not c.holds and c.level == "fail"]
    return {
        c.name.removeprefix("plausibility."): c.sentence
        for c in reversed(failed)
    }


def run(campaign: Path, seed: int, mistakes) -> dict:
    """False alarms of a campaign, and what is said of each mistake."""
    text = (campaign / "study.yaml").read_text("utf-8")
    whole = yaml.safe_load(text)
    row = {"seed": seed, "alarms": {}, "said": {}}
    with tempfile.TemporaryDirectory() as name:
        scratch = Path(name)
        row["alarms"] = judge(whole, scratch, campaign)
        for mistake in mistakes:
            study = copy.deepcopy(whole)
            study["trials"] = study["trials"][:3]
            p = Plant(campaign, scratch, study, seed)
            mistake(p)
            row["said"][mistake.__name__] = judge(p.study, scratch, campaign)
    for read in (recording.read_c3d, mats.read_novel_asc):
        read.cache_clear()
    return row


def summary(rows: list[dict], mistakes) -> dict:
    """Counts over campaigns."""
    caught = {
        m.__name__: {
            "caught": sum(bool(r["said"][m.__name__]) for r in rows),
            "named": sum(
                any(k in r["said"][m.__name__] for k in MISTAKES[m])
                for r in rows
            ),
        }
        for m in mistakes
    }
    alarms = [r["seed"] for r in rows if r["alarms"]]
    return {"campaigns": len(rows), "false_alarms": alarms, "caught": caught}


def text_of(kind: str, found: dict) -> str:
    """The table of one kind of truth, as text."""
    n = found["campaigns"]
    lines = [
        f"{kind}: {n} campaigns, false alarms in "
        f"{len(found['false_alarms'])} {found['false_alarms'] or ''}".rstrip(),
        f"  {'mistake':20s} caught  named",
    ]
    for name, row in found["caught"].items():
        lines.append(
            f"  {name:20s} {row['caught']:3d}/{n} {row['named']:3d}/{n}"
        )
    return "\n".join(lines)


def _campaign(data: Path, kind: str, seed: int) -> Path:
    folder = data / f"{kind}_{seed}"
    if not (folder / "study.yaml").is_file():
        folder.mkdir(parents=True, exist_ok=True)
        dx.write_campaign(folder, seed, truth=kind)
    return folder


def main() -> None:
    """Print a table for each kind of truth."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seeds", default="1:6", help="FIRST:LAST, or a list")
    parser.add_argument("--truth", nargs="+", default=["near", "wide"])
    parser.add_argument("--data", help="folder that keeps the campaigns")
    parser.add_argument("--mistakes", nargs="*", help="some of them; all else")
    parser.add_argument("--json", action="store_true")
    args = parser.parse_args()
    if ":" in args.seeds:
        first, last = map(int, args.seeds.split(":"))
        seeds = list(range(first, last + 1))
    else:
        seeds = [int(s) for s in args.seeds.split(",")]
    chosen = [
        m
        for m in MISTAKES
        if args.mistakes is None or m.__name__ in args.mistakes
    ]
    found = {}
    with tempfile.TemporaryDirectory() as scratch:
        data = Path(args.data or scratch)
        for kind in args.truth:
            rows = []
            progress = Progress(kind, total=len(seeds), stream=sys.stderr)
            for seed in seeds:
                # The laboratory tells its progress, too.
                with contextlib.redirect_stdout(sys.stderr):
                    campaign = _campaign(data, kind, seed)
                rows.append(run(campaign, seed, chosen))
                progress.update(f"seed {seed}", done=len(rows))
            found[kind] = {"rows": rows, **summary(rows, chosen)}
            if not args.json:
                print(text_of(kind, found[kind]), flush=True)
    if args.json:
        print(json.dumps(found, indent=1))


if __name__ == "__main__":
    main()
