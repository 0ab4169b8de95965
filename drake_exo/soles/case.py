"""A case: a sole and the step that it takes, to simulate or optimise."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from drake_exo.errors import InputError, check_type, path_of
from drake_exo.files import schema
from drake_exo.soles.mesh import TetMesh, check_frame, check_mesh
from drake_exo.soles.optimize.design import Design
from drake_exo.soles.optimize.files import Checkpoint, read_checkpoint
from drake_exo.soles.optimize.search import in_own_walk, optimise
from drake_exo.soles.results import Step
from drake_exo.soles.settings import Settings, Setup, StepReader

# A whole case file, small enough for an example.
EXAMPLE = """
name: example
mesh:
  brick: {size_m: [0.23, 0.13, 0.03], divisions: [4, 3, 2]}
material: {name: neoprene}
load:
  constant: {force_n: [10, 0, 400], zmp_m: [0.02, 0.01], samples: 5}
optimize:
  intervals: [3, 3]
  starts: 1
  stages: [{layer_m: 1.0e-4, kappa: 0.2, iterations: 5}]
"""


@dataclass(frozen=True, repr=False)
class Case(Setup):
    """A sole, the step that it takes, and the cost and limits of its shape.

    >>> import drake_exo as dx
    >>> case = dx.soles.Case.from_text(dx.soles.EXAMPLE)
    >>> case.name, case.load.force.shape, case.mesh.nodes.shape
    ('example', (5, 3), (60, 3))
    >>> step = case.simulate()
    >>> best = case.optimize()

    Attributes:
        settings: What the case file says.
        load: Force and ZMP of every sample.
        mesh: Mesh of the initial shape.
        start: How the sole is held just before the first contact.
        ground: Ground that it stands on.
    """

    @classmethod
    def read(
        cls,
        path: Path | str,
        data_root: Path | str | None = None,
        mesh_file: Path | None = None,
        read_step: StepReader | None = None,
    ) -> "Case":
        """Read a case file and the files that it names.

        Args:
            path: The YAML file; docs/soles.md lists its keys.
            data_root: Folder that the case's paths are relative to, by default
                the case file's own.
            mesh_file: Mesh to use instead of the case's, also in the last
                stage of an optimisation.
            read_step: Function that reads a step of a recording; needed for a
                load with `recording`. It is called with the study's path as
                the case gives it, trial, foot, start, end, step (from 0) and
                least force [N], and returns a `RecordedStep`.

        Raises:
            InputError: The case cannot be read (the message has file, line,
                key and remedy), or the ZMP leaves the sole.
        """
        settings = Settings.read(path)
        root = data_root or Path(path).parent
        try:
            return cls.open(settings, root, mesh_file, read_step)
        except InputError as error:
            raise InputError(f"{path}: {error}") from error

    @classmethod
    def from_text(
        cls,
        text: str,
        data_root: Path | str = ".",
        read_step: StepReader | None = None,
    ) -> "Case":
        """Make a case from the text of a case file; see `read`."""
        check_type(text, str, "text")
        settings = schema.load_text(text, Settings, "case")
        return cls.open(settings, data_root, read_step=read_step)

    def simulate(
        self, progress: Callable[[int, int], None] | None = None
    ) -> Step:
        """Simulate the sole through its step, by the exact contact law.

        Args:
            progress: Called with the number of samples done, and of all.

        Raises:
            InputError: The load's ZMP leaves the sole, or its force leaves
                the friction cone; or a mesh made in Python is not sound.
        """
        return Step.of(self._checked(), progress=progress)

    def optimize(
        self,
        folder: Path | str | None = None,
        say: Callable[[str], object] | None = None,
        resume: Checkpoint | Path | str | None = None,
        at_once: int = 1,
    ) -> Design:
        """Find the best shape for the step, from several starts, in stages.

        Args:
            folder: Where to keep checkpoint.json, which is replaced every few
                iterations; made if it does not exist. None keeps none.
            say: Called with one line of progress now and then.
            resume: Earlier checkpoint to go on from, or the folder it is in.
            at_once: Number of processes that search the starts; with 1 this
                process does all of it.

        Raises:
            InputError: The checkpoint is damaged or of another case; the load
                cannot be carried, as in `simulate`; or a walk is sought and
                the load is not its own.
        """
        case = self._checked()
        case._check_walk()
        if not isinstance(resume, Checkpoint | None):
            resume = read_checkpoint(path_of(resume, "resume"))
        if resume is not None and resume.case not in ("", self.name):
            raise InputError(
                f"resume: the checkpoint is of the case {resume.case!r}, "
                f"this one is {self.name!r}; give the case that was begun"
            )
        # The search for a walk begins as that of the sole alone: its key, too.
        keys = "", case.key, in_own_walk(case).key
        if resume is not None and resume.key not in keys:
            raise InputError(
                "resume: the checkpoint is of other settings, another mesh or "
                "another load of this case; only iterations may change"
            )
        folder = None if folder is None else path_of(folder, "folder")
        say = say or (lambda text: None)
        return optimise(case, folder, say, resume, at_once)

    def _checked(self) -> "Case":
        """The case, with moments that friction bears as in a file's loads.

        Refuses what a case made in Python may hold, and a file may not.
        """
        check_type(self.mesh, TetMesh, "mesh")
        check_mesh(self.mesh, "mesh")
        check_frame(self.mesh, "mesh")
        self.check_load()
        return replace(self, load=self.bearable_load)

    def _check_walk(self) -> None:
        """Refuse a load that is not of the walk that is sought with it."""
        if self.gait is None:
            return
        own, load = self.gait.load(self.gait.start), self.load
        near = 1e-6 * own.largest_force
        if own.force.shape != load.force.shape or not (
            np.allclose(own.force, load.force, rtol=0.0, atol=near)
            and np.allclose(own.zmp, load.zmp, rtol=0.0, atol=1e-6)
        ):
            raise InputError(
                f"{load.name}: is not the load of the walk that is sought "
                "(load.pattern.free); leave free out of the case for a load "
                "of your own"
            )
