"""Replays of soles from the folders that the commands wrote."""

from pathlib import Path

from drake_exo.errors import InputError
from drake_exo.files.output import read_json
from drake_exo.soles.animation import SoleMotion, write_animation

HISTORY, FIRST_HISTORY = "history.npz", "initial_history.npz"


def replay_soles(folder: Path, path: Path) -> None:
    """Write the page of all soles under a folder.

    Args:
        folder: that `sole simulate`, `sole optimize` or `sole study` wrote.
        path: of the page.

    Raises:
        InputError: there is no sole that converged, or a file is damaged.
    """
    motions = []
    for history in sorted(Path(folder).rglob(HISTORY)):
        name = _name(history.parent)
        first = history.with_name(FIRST_HISTORY)
        titles = {history: name}
        if first.is_file():
            titles = {
                history: f"{name}: optimised",
                first: f"{name}: initial shape",
            }
        motions += [
            SoleMotion.read(file, title, name) for file, title in titles.items()
        ]
    shown = [motion for motion in motions if motion is not None]
    if not shown:
        raise InputError(
            f"{folder}: holds no {HISTORY} of a sole that converged; give the "
            "--out folder of 'drake-exo sole simulate', 'optimize' or 'study'"
        )
    groups = sorted({motion.group for motion in shown})
    write_animation(path, shown, f"Sole {', '.join(groups)}")


def _name(folder: Path) -> str:
    """Of the case in a folder."""
    summary = read_json(
        folder / "summary.json", "run the command that wrote it again"
    )
    name = summary.get("name") if isinstance(summary, dict) else None
    return name if isinstance(name, str) else folder.name
