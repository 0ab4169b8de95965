"""What calibrations never read: true motion, forces and parameters."""

from pathlib import Path

import numpy as np

from drake_exo.files.opensim import write_table
from drake_exo.files.output import write_json
from drake_exo.files.tables import Table
from drake_exo.model.plant import COUPLED_COORDINATES
from drake_exo.virtual_laboratory.instruments import MARKER_RATE_HZ, Clocks
from drake_exo.virtual_laboratory.simulation import RATE_HZ, Simulated
from drake_exo.virtual_laboratory.truth import Truth

_STEP = round(RATE_HZ / MARKER_RATE_HZ)


def write_parameters(
    folder: Path, truth: Truth, seed: int, active: frozenset[str]
) -> None:
    """Write all of it, and each phase's parameters by their names there."""
    about = {"seed": seed, "disturbances": active}
    write_json(folder / "truth.json", {**about, "parameters": truth})
    for name, contacts in (
        ("foot_ground", truth.contact.spheres),
        ("interaction", {n: c.bushing for n, c in truth.cuffs.items()}),
    ):
        values = {
            f"{part}.{key}": value
            for part, contact in contacts.items()
            for key, value in vars(contact).items()
        }
        write_json(folder / f"{name}.json", {**about, "parameters": values})


def write_motion(
    folder: Path, movement: Simulated, clocks: Clocks | None = None
) -> None:
    """Write what truly happened in a movement, and its clocks' lags."""
    name = movement.name
    write_table(
        folder / f"{name}.sto",
        truth_table(movement),
        f"{name}: what truly happened",
    )
    if clocks is not None:
        write_json(folder / f"{name}_clocks.json", clocks)


def truth_table(movement: Simulated) -> Table:
    """Motion, joint torques and forces at the markers' rate, in SI units."""
    names, columns = [], []
    for suffix, values in (
        ("", movement.q),
        ("_speed", movement.v),
        ("_acceleration", movement.a),
    ):
        names += [name + suffix for name in COUPLED_COORDINATES]
        columns.append(values)
    names += [f"{name}_torque" for name in COUPLED_COORDINATES[3:]]
    columns.append(movement.torque)
    for place, w in (("ground", movement.ground), ("chair", movement.chair)):
        names += [f"{place}_{k}" for k in ("force_x", "force_z", "moment_y")]
        columns.append(np.column_stack([w.force, w.moment]))
    names += [
        f"{cuff}_{component}"
        for cuff in ("shank", "thigh", "pelvis")
        for component in ("tangential", "normal", "rotation")
    ]
    columns.append(movement.interaction)
    values = np.hstack(columns)[::_STEP]
    return Table(movement.times[::_STEP], tuple(names), values, False)
