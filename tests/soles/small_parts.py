"""Shape problems, and steps in part, of what a test gives."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np

from drake_exo.soles.case import EXAMPLE, Case
from drake_exo.soles.contact.law import FLAT
from drake_exo.soles.contact.newton import Start
from drake_exo.soles.optimize.problem import ShapeProblem
from drake_exo.soles.results import Step
from drake_exo.soles.settings import Setup, Stage
from drake_exo.soles.simulation import sigma_max_translation, sigma_min_rotation

# The heel's edge of a brick of 0.23 m by 0.13 m by 0.03 m touches first.
START = Start(np.array([-0.115, 0, -0.03]), np.array([-0.115, 0.0, 0.0]))


def small_problem(
    mesh, load, start, stage: Stage, element="linear", cost=None, **optimize
) -> ShapeProblem:
    """Neoprene on friction 0.8; keys of `cost` and of `optimize` as given."""
    settings = Case.from_text(EXAMPLE).settings
    settings = replace(
        settings,
        contact=replace(settings.contact, friction=0.8),
        mesh=replace(settings.mesh, element=element),
        cost=replace(settings.cost, **(cost or {})),
        optimize=replace(settings.optimize, stages=(stage,), **optimize),
    )
    return ShapeProblem(Setup(settings, load, mesh, start), stage)


def with_setup(problem: ShapeProblem, **changes) -> ShapeProblem:
    """The same problem of another load, say, its first shape anew."""
    setup = replace(problem.setup, **changes)
    return type(problem)(setup, setup.settings.optimize.stages[0])


def complementarity(history, law, start, places, begins=(0,), ground=FLAT):
    """That of a step of which nothing else is known."""
    load = SimpleNamespace(begins=begins)
    return Step.complementarity(
        SimpleNamespace(
            history=history,
            law=law,
            sole=SimpleNamespace(positions=places),
            setup=SimpleNamespace(start=start, load=load, ground=ground),
        )
    )


def measure(history, by_tr, by_rot):
    """Weighted sum of c_tr and c_rot over the samples."""
    by_tr = by_tr @ sigma_max_translation(history.K_c)
    return by_tr + by_rot @ sigma_min_rotation(history.K_c)
