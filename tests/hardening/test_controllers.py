"""--controller with names and code that make no sense: one sentence."""

import sys

import numpy as np
import pytest
from pydrake.systems.framework import BasicVector, LeafSystem, LeafSystem_
from pydrake.systems.scalar_conversion import TemplateSystem

from drake_exo.cli.predict import load_controller
from drake_exo.collocation.kernels import ControllerKernel
from drake_exo.errors import InputError

_MODULE = """
import sys
from pydrake.systems.framework import LeafSystem
class Wants:
    def __init__(self, gain): pass
class Fails:
    def __init__(self): raise RuntimeError("no\\nluck")
def leaves(): sys.exit(3)
def nothing(): return None
number = 3
class Bare(LeafSystem): pass
"""


def test_names_at_random():
    rng = np.random.default_rng(0)
    letters = [*"abcos:._-/ \n\0é1", "sys", "drake_exo", "abort", "numpy"]
    for _ in range(2000):
        name = "".join(rng.choice(letters, size=rng.integers(0, 8)))
        with pytest.raises(InputError) as error:
            load_controller(name)
        assert "\n" not in str(error.value)


@pytest.mark.parametrize(
    ("name", "words"),
    [
        ("Wants", "cannot be made"),
        ("Fails", r"cannot be made \(no\)"),
        ("leaves", r"cannot be made \(3\)"),
        ("nothing", "is not a Drake system"),
        ("number", "no class or function"),
        ("absent", "cannot be made"),
    ],
)
def test_code_that_makes_no_controller(name, words, tmp_path, monkeypatch):
    (tmp_path / "my_controllers.py").write_text(_MODULE)
    monkeypatch.syspath_prepend(str(tmp_path))
    with pytest.raises(InputError, match=words):
        load_controller(f"my_controllers:{name}")


def test_modules_of_the_working_folder_are_found(tmp_path, monkeypatch):
    """An installed command has the folder of its script on the path instead."""
    (tmp_path / "beside_the_study.py").write_text(_MODULE)
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "path", [p for p in sys.path if p])
    made = load_controller("beside_the_study:Bare")
    assert type(made).__module__ == "beside_the_study"


@pytest.mark.parametrize("text", ["def (", "raise OSError('x')", "1/0", "\0"])
def test_modules_that_do_not_import(text, tmp_path, monkeypatch):
    (tmp_path / "broken_module.py").write_text(text)
    monkeypatch.syspath_prepend(str(tmp_path))
    with pytest.raises(InputError, match="cannot be made"):
        load_controller("broken_module:Thing")


class Sized(LeafSystem):
    """The right names, the wrong sizes, or an error of its own."""

    def __init__(self, inputs=6, outputs=3, fails=False):
        super().__init__()
        self._fails = fails
        self.DeclareVectorInputPort("exoskeleton_state", inputs)
        self.DeclareVectorOutputPort(
            "exoskeleton_torques", BasicVector(outputs), self._calc
        )

    def _calc(self, context, output):
        if self._fails:
            raise RuntimeError("as planned")

    def ToAutoDiffXd(self):
        return self


def test_ports_of_other_sizes():
    for system, words in (
        (LeafSystem(), "has no input port"),
        (Sized(inputs=4), "has 4 values, but the device 3 joints: declare 6,"),
        (Sized(fails=True), "as planned"),
    ):
        with pytest.raises(InputError, match=words):
            ControllerKernel(system, 3)


@TemplateSystem.define("Spring_", scope=sys.modules[__name__])
def Spring_(T):
    class Impl(LeafSystem_[T]):
        def _construct(self, stiffness=1.0, kept=True, converter=None):
            super().__init__(converter=converter)
            self.stiffness, self.kept = stiffness, kept
            self.DeclareVectorInputPort("exoskeleton_state", 6)
            self.DeclareVectorOutputPort("exoskeleton_torques", 3, self._calc)

        def _construct_copy(self, other, converter=None):
            values = [other.stiffness] if other.kept else []
            Impl._construct(self, *values, converter=converter)

        def _calc(self, context, output):
            state = self.GetInputPort("exoskeleton_state").Eval(context)
            output.SetFromVector(-self.stiffness * state[:3])

    return Impl


def test_a_copy_that_forgets_its_values_is_told():
    """A prediction would be solved with derivatives of another controller."""
    ControllerKernel(Spring_[float](20.0), 3)
    with pytest.raises(InputError, match="gives other torques once it"):
        ControllerKernel(Spring_[float](20.0, kept=False), 3)
