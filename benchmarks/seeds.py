"""How well calibrated cuffs predict people whom nobody tuned on.

For each seed: a campaign of the virtual laboratory, Phases A and B from its
files, and six movements predicted with calibrated cuffs, with nominal ones and,
with --floor, with true ones and the calibration's own errors of measurement.
Forces are compared with the truth: the RMS over time of each cuff's normal and
tangential force, averaged over movements, of which the largest counts; and, as
in the paper, normal forces with the mats. Clocks are compared with the truth,
too, and with what the mats would tell of theirs if the true force were known.

    python benchmarks/seeds.py --seeds 1:40 [--truth wide] [--floor] [--json]

Settings of the program were chosen on seeds 1 to 40.
"""

import argparse
import json
import tempfile
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
from calls import run_calls
from scipy.linalg import toeplitz
from scipy.stats import norm

import drake_exo as dx
from drake_exo.calibration.audit import rms
from drake_exo.calibration.clocks import LARGEST_DOUBT_S, Clock
from drake_exo.calibration.error_model import ErrorSizes
from drake_exo.files.opensim import read_table
from drake_exo.files.output import read_json
from drake_exo.measurement.filters import low_pass
from drake_exo.study import uncalibrated

_LAGS = np.arange(-0.1, 0.1005, 0.001)


def run(seed: int, kind: str, data: str | None, floor: bool) -> dict:
    """Row of one seed; simulates its campaign unless `data` holds it."""
    with tempfile.TemporaryDirectory() as scratch:
        folder = Path(data or scratch) / f"{kind}_{seed}"
        folder.mkdir(parents=True, exist_ok=True)
        if not (folder / "study.yaml").is_file():
            dx.write_campaign(folder, seed, truth=kind)
        return _row(folder, seed, floor)


def _row(folder: Path, seed: int, floor: bool) -> dict:
    start = time.perf_counter()
    study = dx.read_study(folder / "study.yaml")
    refused = [c.name for c in study.plausibility() if not c.holds]
    first = dx.calibrate_foot_ground(study)
    cuffs = dx.calibrate_interaction(study, contact=first)
    row = {"seed": seed, "refused": refused}
    row |= {"A": _solve(first), "B": _solve(cuffs)}
    if not cuffs.success:
        return row
    row["at_bound"] = sum(p.at_bound(p.nominal) for p in cuffs.parameters)
    row["free"] = sum(p.free for p in cuffs.parameters)
    row["intervals"] = _intervals(cuffs, _true(folder, cuffs.contact))
    contacts = {
        "calibrated": cuffs.contact,
        "uncalibrated": uncalibrated(study.model, cuffs),
    }
    if floor:
        contacts["floor"] = _true(folder, cuffs.contact)
    trials, clocks = study.trials("prediction"), cuffs.clocks
    for name, contact in contacts.items():
        found = [dx.predict(study, trial, contact) for trial in trials]
        row[name] = _errors(folder, trials, found)
        if name == "calibrated":
            row["C1"] = [_solve(p) for p in found]
            clocks += [c for p in found for c in p.clocks]
            bands = [
                (p, p.bands(), t) for p, t in zip(found, trials, strict=True)
            ]
            row["coverage"] = [b.coverage(p, p.timed(t)) for p, b, t in bands]
    row["clocks"] = _clocks(folder, study.trials(), clocks)
    row["clocks_by_force"] = _clocks_by_force(folder, study.trials())
    row["seconds"] = time.perf_counter() - start
    return row


def _solve(found) -> dict:
    s = found.solution
    return {
        "success": s.success,
        "status": s.status,
        "iterations": s.iterations,
        "seconds": s.seconds["build"] + s.seconds["solve"],
    }


def _true(folder: Path, contact: dx.ContactModel) -> dx.ContactModel:
    """The contact with the cuffs' true values; preloads are kept."""
    told = read_json(folder / "truth" / "truth.json", "")["parameters"]["cuffs"]
    bushings = {}
    for cuff, own in contact.bushings.items():
        values = dict(told[cuff]["bushing"])
        values |= {
            k: v for k, v in vars(own).items() if k.startswith("preload")
        }
        bushings[cuff] = replace(own, **values)
    return replace(contact, bushings=bushings)


def _intervals(cuffs, true: dx.ContactModel) -> list[dict]:
    """Error and half 95 % interval of each free parameter with a true one.

    Left out are parameters at a bound, which have no interval, and slip, for
    which the laboratory has another law.
    """
    values, found = true.values(), cuffs.uncertainty()
    mean = {p.name: p.nominal for p in cuffs.parameters}
    return [
        {
            "name": name,
            "error": mean[name] - values[name],
            "half_width": half,
            "identifiable": bool(told),
        }
        for name, half, told in zip(
            found.names,
            found.half_width.tolist(),
            found.identifiable,
            strict=True,
        )
        if np.isfinite(half) and not name.endswith(".slip")
    ]


def _errors(folder: Path, trials, found) -> dict:
    """Errors of the predicted movements together, against the truth."""
    good = [(t, f) for t, f in zip(trials, found, strict=True) if f.success]
    if len(good) < len(trials):
        return {"solved": len(good)}
    force, angles, rates, mats = [], [], [], []
    for trial, f in good:
        truth = read_table(folder / "truth" / f"{trial.name}.sto")
        at = trial.start_s + f.times

        def true(name, truth=truth, at=at):
            return np.interp(at, truth.time, truth.column(name))

        force.append(
            {
                f"{cuff}_{what}": float(rms(x - true(f"{cuff}_{what}")))
                for cuff, c in f.cuffs.items()
                for what, x in (
                    ("normal", c.normal),
                    ("tangential", c.tangential),
                )
            }
        )
        for joint in f.coordinates.joints:
            angles.append(rms(f.coordinate(joint) - true(joint)))
            rates.append(rms(f.velocity(joint) - true(f"{joint}_speed")))
        mats.append(f.rmsd(trial)["interaction_n"])
    parts = {k: float(np.mean([row[k] for row in force])) for k in force[0]}
    seen = {
        cuff: float(np.mean([m[cuff] for m in mats if cuff in m]))
        for cuff in dict.fromkeys(c for m in mats for c in m)
    }
    return {
        "solved": len(good),
        "interaction_n": max(parts.values()),
        "parts_n": parts,
        "mats_n": seen,
        "angle_deg": float(np.rad2deg(max(angles))),
        "velocity_deg_s": float(np.rad2deg(max(rates))),
    }


def _clocks(folder: Path, trials, found) -> list[dict]:
    """Error of each clock of device and mats, and its SD [s].

    A clock not found counts as unsure, with the lag that was taken out.
    """
    known = {(c.trial, c.system): c for c in found}
    rows = []
    for trial in trials:
        true = read_json(folder / "truth" / f"{trial.name}_clocks.json", "")
        for system, key in (("encoders", "device"), ("pressure", "mats")):
            clock = known.get((trial.name, system))
            lag = trial.provenance["delays_s"][system]
            rows.append(
                {
                    "trial": trial.name,
                    "system": system,
                    "error_s": (clock.lag_s if clock else lag) - true[key],
                    "sd_s": clock.sd_s if clock else None,
                    "unsure": not (clock and clock.sure),
                }
            )
    return rows


def _clocks_by_force(folder: Path, trials) -> list[dict]:
    """Errors and SD of the mats' clocks if the true force is known [s].

    Share, offset and lag are fitted to what mats show, with the priors of the
    error model; residuals are weighted by their own covariance in time.
    """
    shown, left = [], {}
    for trial in trials:
        truth = read_table(folder / "truth" / f"{trial.name}.sto")
        true = read_json(folder / "truth" / f"{trial.name}_clocks.json", "")
        rate = 1.0 / (truth.time[1] - truth.time[0])
        at = trial.start_s + trial.times
        mats = {}
        for cuff, own in trial.cuffs.items():
            force = low_pass(truth.column(f"{cuff}_normal"), rate)
            later = np.array(
                [np.interp(at - k, truth.time, force) for k in _LAGS]
            )
            mats[cuff] = own.normal, later
            X = later[np.argmin(np.abs(_LAGS - true["mats"]))]
            X = np.column_stack([X, np.ones(len(at))])
            fit = np.linalg.lstsq(X, own.normal, rcond=None)[0]
            left.setdefault(cuff, []).append(own.normal - X @ fit)
        shown.append((true["mats"], mats))
    rows, sizes = [], ErrorSizes()
    prior = np.diag([sizes.mat_share**-2, sizes.mat_offset_n**-2])
    for true, mats in shown:
        cost = (_LAGS / sizes.mat_clock_s) ** 2
        for cuff, (force, later) in mats.items():
            weight = _weight(left[cuff], len(force))
            for k, told in enumerate(later):
                X = np.column_stack([told, np.ones(len(told))])
                y = force - told
                b = X.T @ weight @ y
                cost[k] += y @ weight @ y
                cost[k] -= b @ np.linalg.solve(X.T @ weight @ X + prior, b)
        k = int(np.clip(np.argmin(cost), 1, len(cost) - 2))
        step = _LAGS[1] - _LAGS[0]
        bend = (cost[k - 1] - 2.0 * cost[k] + cost[k + 1]) / step**2
        rows.append(
            {
                "error_s": float(_LAGS[k] - true),
                "sd_s": float(np.sqrt(2.0 / bend)),
            }
        )
    return rows


def _weight(left: list[np.ndarray], count: int) -> np.ndarray:
    """Inverse covariance (count, count) of stationary errors like `left`."""
    covariance = np.zeros(count)
    longest = min(count, *map(len, left))
    covariance[:longest] = [
        np.mean([e[: len(e) - k] @ e[k:] / len(e) for e in left])
        for k in range(longest)
    ]
    values, vectors = np.linalg.eigh(toeplitz(covariance))
    return (vectors / np.maximum(values, 1e-3)) @ vectors.T


def _known(clocks: list[dict]) -> dict:
    """Errors of clocks compared with their estimated standard deviations.

    Of those called sure also how many are off by more than 10 ms, and how many
    of these are expected by their standard deviations.
    """
    told = [c for c in clocks if c["sd_s"]]
    if not told:
        return {"clocks": 0}
    error, sd = (np.array([c[k] for c in told]) for k in ("error_s", "sd_s"))
    # Whichever system it is.
    sure = np.array([Clock("", "encoders", 0.0, s).sure for s in sd])
    expected = 2.0 * norm.sf(LARGEST_DOUBT_S / sd)
    return {
        "clocks": len(told),
        "error_ms": 1e3 * float(np.sqrt(np.mean(error**2))),
        "median_sd_ms": 1e3 * float(np.median(sd)),
        "error_over_sd": float(np.sqrt(np.mean((error / sd) ** 2))),
        "unsure": float(np.mean(~sure)),
        "beyond_10_ms_unmarked": int(
            np.sum(sure & (np.abs(error) > LARGEST_DOUBT_S))
        ),
        "beyond_10_ms_expected": float(expected[sure].sum()),
    }


def _share(intervals: list[dict]) -> dict:
    """Number of intervals, and the share of them that holds the truth."""
    inside = [abs(i["error"]) <= i["half_width"] for i in intervals]
    return {
        "parameters": len(inside),
        "inside": float(np.mean(inside)) if inside else None,
    }


def summary(rows: list[dict]) -> dict:
    """Medians, worst and shares of all rows that were solved."""
    good = [
        r
        for r in rows
        if "interaction_n" in r.get("calibrated", {})
        and "interaction_n" in r["uncalibrated"]
    ]
    if not good:
        return {"seeds": len(rows), "solved": 0}

    def column(name: str, key: str) -> np.ndarray:
        return np.array([r[name][key] for r in good])

    own = column("calibrated", "interaction_n")
    usual = column("uncalibrated", "interaction_n")
    inside = [
        [c for f in r["coverage"] for c in f["interaction_n"].values()]
        for r in good
    ]
    clocks = [c for r in good for c in r["clocks"]]
    intervals = [i for r in good for i in r["intervals"]]
    off = [c for c in clocks if abs(c["error_s"]) > 0.01]
    iterations = [r["B"]["iterations"] for r in good]
    return {
        "seeds": len(rows),
        "solved": len(good),
        "refused": {r["seed"]: r["refused"] for r in rows if r["refused"]},
        "interaction_n": {
            "median": float(np.median(own)),
            "worst": float(own.max()),
            "uncalibrated_median": float(np.median(usual)),
            "ratio_of_medians": float(np.median(own) / np.median(usual)),
            "share_helped": float(np.mean(own < usual)),
            "share_below_13.1": float(np.mean(own <= 13.1)),
        },
        "angle_deg": float(np.median(column("calibrated", "angle_deg"))),
        "velocity_deg_s": float(
            np.median(column("calibrated", "velocity_deg_s"))
        ),
        "share_angles_and_velocities": float(
            np.mean(
                (column("calibrated", "angle_deg") <= 3.3)
                & (column("calibrated", "velocity_deg_s") <= 14.3)
            )
        ),
        "band_coverage": float(np.mean(np.concatenate(inside))),
        "intervals": _share(intervals),
        "intervals_identifiable": _share(
            [i for i in intervals if i["identifiable"]]
        ),
        "band_coverage_worst_seed": min(float(np.mean(x)) for x in inside),
        "phase_b_iterations_worst": max(iterations),
        "phase_b_seconds_median": float(
            np.median([r["B"]["seconds"] for r in good])
        ),
        "share_at_bound": sum(r["at_bound"] for r in good)
        / sum(r["free"] for r in good),
        "clocks_beyond_10_ms_unmarked": sum(not c["unsure"] for c in off),
        "clocks_unsure": float(np.mean([c["unsure"] for c in clocks])),
        "encoders": _known([c for c in clocks if c["system"] == "encoders"]),
        "mats": _known([c for c in clocks if c["system"] == "pressure"]),
        "mats_by_true_force": _known(
            [c for r in good for c in r["clocks_by_force"]]
        ),
    }


def _text(row: dict) -> str:
    cells = [f"{row['seed']:6d}", f"B {row['B']['iterations']:3d}"]
    for name in ("calibrated", "uncalibrated", "floor"):
        e = row.get(name)
        if e is None:
            continue
        if "interaction_n" not in e:
            cells.append(f"{name} not solved")
            continue
        cells.append(
            f"{name} {e['interaction_n']:5.1f} N {e['angle_deg']:4.1f} deg "
            f"{e['velocity_deg_s']:5.1f} deg/s"
        )
    return " | ".join(cells)


def main() -> None:
    """Print a row for each seed, and the summary of all."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seeds", default="1:40", help="FIRST:LAST, or a list")
    parser.add_argument("--truth", default="wide", choices=["wide", "near"])
    parser.add_argument("--floor", action="store_true")
    parser.add_argument("--data", help="folder that keeps the campaigns")
    parser.add_argument("--workers", type=int, default=2)
    parser.add_argument("--json", action="store_true")
    args = parser.parse_args()
    if ":" in args.seeds:
        first, last = map(int, args.seeds.split(":"))
        seeds = list(range(first, last + 1))
    else:
        seeds = [int(s) for s in args.seeds.split(",")]
    calls = [
        {"seed": s, "kind": args.truth, "data": args.data, "floor": args.floor}
        for s in seeds
    ]
    rows = run_calls(
        run,
        calls,
        args.workers,
        "seeds",
        None if args.json else lambda row: print(_text(row), flush=True),
    )
    found = {"truth": args.truth, "rows": rows, "summary": summary(rows)}
    print(json.dumps(found if args.json else found["summary"], indent=1))


if __name__ == "__main__":
    main()
