"""How results of Phase B depend on the weights.

    python benchmarks/weights.py [--json] [--factors 0.25 4]

Weights are 1/sigma^2 of each signal's measurement noise. Here the sigma of one
group of signals at a time is multiplied by a factor, on noisy data of known
truth. Prints how well the data are fitted then, and how far the cuffs' forces
(also those that no mat measures) and parameters move.
"""

import argparse
import json
import sys
from dataclasses import replace

import numpy as np

from drake_exo.calibration.audit import rms, rmsd
from drake_exo.calibration.uncertainty import uncertainty
from drake_exo.files.output import Progress
from drake_exo.report.gathering import format_table
from drake_exo.virtual_laboratory.synthetic import (
    INSTRUMENT_NOISE,
    noisy,
    rises_in_device,
)

GROUPS = {
    "kinematics": (
        "angle_deg",
        "velocity_deg_s",
        "exo_angle_deg",
        "exo_velocity_deg_s",
        "foot_m",
        "foot_pitch_deg",
        "foot_velocity_m_s",
        "foot_pitch_rate_deg_s",
    ),
    "ground reaction": ("force_n", "cop_m"),
    "joint moments": ("moment_nm", "exo_moment_nm"),
    "mats": ("normal_force_n",),
    "contact energy": ("energy_j",),
}


def sweep(factors: list[float]) -> list[dict]:
    """One row for each group and factor, after one with sigmas as they are."""
    made = rises_in_device()
    trials = [noisy(t, k, INSTRUMENT_NOISE) for k, t in enumerate(made.trials)]
    true = made.contact.values()
    cases = [("as it stands", 1.0, INSTRUMENT_NOISE)]
    for group, names in GROUPS.items():
        for factor in factors:
            own = {n: getattr(INSTRUMENT_NOISE, n) for n in names}
            scaled = {n: factor * v for n, v in own.items()}
            cases.append((group, factor, replace(INSTRUMENT_NOISE, **scaled)))
    rows, base, half = [], None, None
    progress = Progress("weights", total=len(cases), stream=sys.stderr)
    for k, (group, factor, noise) in enumerate(cases):
        settings = made.settings(noise=noise)
        result = made.calibration(settings, trials).solve()
        if base is None:
            base = result
            found = uncertainty(result)
            half, known = found.half_width, found.identifiable
        scores = [
            rmsd(t, m) for t, m in zip(result.trials, trials, strict=True)
        ]
        values, first = (
            np.array([p.nominal for p in r.parameters]) for r in (result, base)
        )
        truth = np.array([true[p.name] for p in result.parameters])
        unseen = [
            rms(a.cuffs[cuff].components - b.cuffs[cuff].components).max()
            for a, b in zip(result.trials, base.trials, strict=True)
            for cuff in b.cuffs
        ]
        rows.append(
            {
                "group": group,
                "factor": factor,
                "success": result.success,
                "angles_deg": _mean(scores, "angles_deg"),
                "grf_n": _mean(scores, "grf_n"),
                "moments_nm": _mean(scores, "moments_nm"),
                "interaction_n": _mean(scores, "interaction_n"),
                "interaction_change_n": float(max(unseen)),
                "parameter_change_of_95": float(
                    np.max((np.abs(values - first) / half)[known])
                ),
                "parameter_error_of_95": float(
                    np.max((np.abs(values - truth) / half)[known])
                ),
            }
        )
        progress.update(f"{group} x {factor:g}", done=k + 1)
    return rows


def _mean(scores, key) -> float:
    return float(np.mean([v for s in scores for v in s[key].values()]))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--factors", type=float, nargs="+", default=[0.25, 4.0])
    parser.add_argument("--json", action="store_true")
    args = parser.parse_args()
    rows = sweep(args.factors)
    if args.json:
        print(json.dumps(rows, indent=2))
        return
    keys = list(rows[0])[3:]
    header = ["sigma of", "x", *keys]
    print(
        format_table(
            header,
            [
                [r["group"], f"{r['factor']:g}", *(r[k] for k in keys)]
                for r in rows
            ],
            3,
        )
    )


if __name__ == "__main__":
    main()
