"""Times of the sole half: simulation, both contact methods, the gradient.

python benchmarks/sole.py [--json] [--data-root DIR] [--full]
    [--nodes 100 200 400 800]
"""

import argparse
import json
import os
import time
from dataclasses import replace
from pathlib import Path

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np

from drake_exo.papers.de_magistris import SIZE, five_cases, step_block
from drake_exo.soles.contact.gauss_seidel import GaussSeidelSolver
from drake_exo.soles.contact.law import ContactLaw
from drake_exo.soles.contact.newton import ContactSolver, Start
from drake_exo.soles.elasticity import MATERIALS, Sole
from drake_exo.soles.load_blocks import LoadBlock
from drake_exo.soles.mesh import SphericalSpline, brick
from drake_exo.soles.optimize.adjoint import gradients, singular_terms
from drake_exo.soles.optimize.limits import StrainNorm
from drake_exo.soles.optimize.optimizer import minimise
from drake_exo.soles.optimize.problem import ShapeProblem
from drake_exo.soles.optimize.search import first_design
from drake_exo.soles.settings import Setup, Stage
from drake_exo.soles.simulation import heel_strike_count, simulate
from drake_exo.soles.walking_pattern import Robot

START = Start(np.array([-0.115, 0, -0.03]), np.array([-0.115, 0.0, 0.0]))
MESHES = {"600 nodes": (14, 7, 4), "7000 tets": (20, 12, 5)}
METHODS = {100: (8, 5, 3), 200: (12, 7, 3), 400: (18, 10, 4),
           800: (26, 15, 5)}  # fmt: skip


def timed(function):
    began = time.perf_counter()
    out = function()
    return out, time.perf_counter() - began


def run(sole, law, load, rows, solver=None, **more):
    solver = solver or ContactSolver(sole.compliance, sole.positions, law)
    return simulate(solver, load.at(rows), START, **more)


def simulation(load):
    out = {}
    for name, divisions in MESHES.items():
        sole = Sole(brick(SIZE, divisions), MATERIALS["neoprene"])
        _, condensation = timed(lambda s=sole: s.compliance)
        law = ContactLaw(0.8, sole.penalty)
        history, contact = timed(
            lambda s=sole, w=law: run(s, w, load, slice(None))
        )
        out[name] = {
            "nodes": len(sole.mesh.nodes),
            "tets": len(sole.mesh.tets),
            "steps": len(history.reports),
            "failed_steps": history.failed_steps,
            "condensation_seconds": condensation,
            "contact_seconds": contact,
            "total_seconds": condensation + contact,
        }
    return out


def methods(load, full, nodes):
    out = {}
    for name in nodes:
        divisions = METHODS[name]
        sole = Sole(brick(SIZE, divisions), MATERIALS["neoprene"])
        law = ContactLaw(0.8, sole.penalty)
        rows = slice(0, None) if full else slice(0, 60)
        slow = GaussSeidelSolver(sole.compliance, sole.positions, law)
        run(sole, law, load, slice(0, 1), slow)  # compiles
        b, newton = timed(lambda s=sole, w=law, r=rows: run(s, w, load, r))
        a, sweeps = timed(
            lambda s=sole, w=law, r=rows, g=slow: run(s, w, load, r, g)
        )
        count = len(a.reports)
        out[f"about {name}"] = {
            "contact_nodes": len(sole.positions),
            "gauss_seidel_ms_per_step": 1e3 * sweeps / count,
            "newton_ms_per_step": 1e3 * newton / count,
            "largest_difference_m": float(np.abs(a.P - b.P).max()),
        }
    return out


def gradient(load, full):
    out = {}
    large = ((36, 24, 8),) if full else ()  # 41 472 tets
    for divisions in ((10, 6, 3), (18, 12, 4), *large):
        mesh = brick(SIZE, divisions)
        spline = SphericalSpline()
        sole = Sole(mesh, MATERIALS["neoprene"])
        law = ContactLaw(0.8, sole.penalty, 1e-5, 0.1)

        def forward(s=sole, w=law):
            solver = ContactSolver(s.compliance, s.positions, w)
            return solver, run(s, w, load, slice(None), solver, keep=True)

        (solver, history), there = timed(forward)
        n = len(load.times)
        early = np.arange(n) < heel_strike_count(n)
        terms = singular_terms(history.K_c, early * 1.0, -np.ones(n))
        other = singular_terms(history.K_c, np.zeros(n), np.ones(n))

        def back(f, s=sole, v=solver, h=history):
            return gradients(s, v, load, START, h, f)

        def strain(s=sole, h=history):
            return StrainNorm(s, h, np.ones(len(h.K_c))).derivatives()

        _, one = timed(lambda t=terms: back([t]))
        _, two = timed(lambda t=terms, o=other: back([t, o]))
        limit, norm = timed(strain)
        _, with_strain = timed(lambda t=terms, o=limit: back([t, o]))
        out[f"{len(mesh.tets)} tets"] = {
            "coefficients": spline.count,
            "forward_seconds": there,
            "gradient_over_forward": one / there,
            "further_over_forward": (two - one) / there,
            "strain_over_forward": (with_strain - one + norm) / there,
        }
    return out


def optimisation(load):
    """Case 1-Ref with all limits: ten iterations on two meshes."""
    out = {}
    settings = five_cases(LoadBlock(pattern=Robot()), coarse=True)[0]
    setup = replace(Setup.open(settings), load=load)
    bounds = tuple(settings.optimize.bounds)
    for stage in (Stage((10, 6, 3), 24, 3e-4, 0.2, 10),
                  Stage((14, 8, 4), 60, 3e-5, 0.2, 5)):  # fmt: skip
        problem = ShapeProblem(setup, stage)
        p = first_design(problem, bounds)
        best, seconds = timed(
            lambda q=problem, x=p, n=stage.iterations: minimise(q, x, bounds, n)
        )
        count = len(best.trace) - 1
        out[f"{len(problem.mesh.tets)} tets, {stage.samples} samples"] = {
            "iterations": count,
            "simulations": problem.evaluations,
            "seconds_per_iteration": seconds / max(count, 1),
            "cost": best.cost,
        }
    return out


def main():
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--json", action="store_true")
    parser.add_argument("--full", action="store_true",
                        help="all samples for both methods, and the "
                        "gradient of 41 472 tets")  # fmt: skip
    parser.add_argument("--nodes", type=int, nargs="+", choices=METHODS,
                        default=list(METHODS),
                        help="on the bottom, for both methods")  # fmt: skip
    parser.add_argument("--data-root", type=Path)
    args = parser.parse_args()
    load = step_block(args.data_root).load(args.data_root or Path("."))
    numbers = {
        "simulation": simulation(load),
        "methods": methods(load, args.full, args.nodes),
        "gradient": gradient(load, args.full),
        "optimisation": optimisation(load),
    }
    if args.json:
        print(json.dumps(numbers, indent=2))
        return
    for part, rows in numbers.items():
        print(part)
        for name, row in rows.items():
            text = ", ".join(
                f"{k} {v:.4g}" if isinstance(v, float) else f"{k} {v}"
                for k, v in row.items()
            )
            print(f"  {name}: {text}")


if __name__ == "__main__":
    main()
