"""Draws docs/pictures/rise.png: a rise from a chair with the device."""

from pathlib import Path

import numpy as np
from matplotlib.image import imsave

from drake_exo.model.plant import nominal_model
from drake_exo.report.scene import Scene

_FOLDER = Path(__file__).parent / "pictures"


def write_png(path: Path, colours: np.ndarray) -> None:
    """Write colours (height, width, 3) without the software's name."""
    imsave(path, colours, metadata={"Software": None})


def main() -> None:
    """Write the picture."""
    coupled = Scene(nominal_model("coupled"), chair_height_m=0.43)
    # The exoskeleton's angles differ a little: straps are soft.
    poses = [
        coupled.upright_pose(joints, offsets)
        for joints, offsets in (
            ((8.0, 92.0, 84.0), (-1.0, -2.0, 2.0)),
            ((20.0, 60.0, 75.0), (-1.0, -3.0, 2.0)),
            ((0.0, 0.0, 0.0), (0.0, 0.0, 0.0)),
        )
    ]
    rise = [coupled.render(q, width=520, height=680) for q in poses]
    write_png(_FOLDER / "rise.png", np.hstack(rise))


if __name__ == "__main__":
    main()
