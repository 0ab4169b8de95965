"""Figures that are not drawn, for tests of what stands beside them."""

from contextlib import contextmanager
from pathlib import Path

import pytest
from matplotlib.figure import Figure


@contextmanager
def undrawn():
    """Within it, figures are saved as files without a picture."""

    def save(figure, path, **options):
        Path(path).write_bytes(b"not drawn")

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(Figure, "savefig", save)
        patch.setattr(Figure, "tight_layout", lambda *args, **options: None)
        yield
