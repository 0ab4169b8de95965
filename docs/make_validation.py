"""Makes the tables of docs/validation.md from the program as it is.

    python docs/make_validation.py [weights intervals seeds campaigns opencap]

All of them take about an hour on two cores.
"""

import argparse
import json
import os
import re
import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np

import drake_exo as dx
from drake_exo.calibration.audit import spread

_ROOT = Path(__file__).resolve().parents[1]
_PAGE = _ROOT / "docs" / "validation.md"
_SEEDS = (1,)  # that of the demo
_HELD = "624:653"
# Rows of the tables: key of `rmsd` -> title on the page.
_SIGNALS = {
    "angles_deg": "angles °",
    "velocities_deg_s": "velocities °/s",
    "grf_n": "ground reaction N",
    "cop_mm": "centre of pressure mm",
    "moments_nm": "joint moments N m",
}
_CUFFS = {"pelvis": "pelvis N", "thigh": "thigh N", "shank": "shank N"}
_PAPER = {
    "angles °": ("1.1", "3.3", "0.8"),
    "velocities °/s": ("6.8", "14.3", "6.5"),
    "ground reaction N": ("8.4", "", "10"),
    "centre of pressure mm": ("", "", "1.0"),
    "joint moments N m": ("10", "", ""),
    "pelvis N": ("5.4", "13.1", ""),
    "thigh N": ("2.3", "13.1", ""),
    "shank N": ("2.2", "13.1", ""),
}


def main() -> None:
    """Make the tables that were asked for, each written as it is done."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("tables", nargs="*", choices=[*_TABLES, []])
    chosen = parser.parse_args().tables or list(_TABLES)
    for name in chosen:
        print(f"== {name}", flush=True)
        lines = _TABLES[name]()
        text = _PAGE.read_text("utf-8")
        block = f"<!-- {name} -->\n" + "\n".join([*lines, "<!-- end -->"])
        pattern = rf"<!-- {name} -->\n.*?<!-- end -->"
        if not re.search(pattern, text, re.DOTALL):
            raise ValueError(f"{_PAGE} has no place for {name}")
        text = re.sub(pattern, lambda _, b=block: b, text, flags=re.DOTALL)
        _PAGE.write_text(text, encoding="utf-8")


def weights() -> list[str]:
    """Largest changes when the sigma of one group of signals is changed."""
    rows = _benchmark("weights.py")
    groups = dict.fromkeys(r["group"] for r in rows[1:])
    lines = _header("σ of", "cuff force N", "parameter, in its 95 % interval")
    for group in groups:
        own = [r for r in rows if r["group"] == group]
        force = max(r["interaction_change_n"] for r in own)
        parameter = max(r["parameter_change_of_95"] for r in own)
        lines.append(_row(group, f"{force:.1f}", f"{parameter:.2f}"))
    return lines


def intervals() -> list[str]:
    """How often 95 % intervals of parameters hold the truth."""
    found = _benchmark("interval_coverage.py", "--seeds", "200")["rows"]
    lines = _header("parameter", "inside, %")
    for r in (r for r in found if r["identifiable"]):
        lines.append(_row(r["parameter"], f"{100 * r['coverage']:.1f}"))
    solved, failed = found[0]["seeds"], found[0]["failed"]
    return [*lines, "", f"Solved: {solved} of {solved + failed}."]


def seeds() -> list[str]:
    """Predictions for subjects of wide truth that nothing was tuned on."""
    found = _benchmark("seeds.py", "--seeds", _HELD, "--floor")
    lines = _header(
        "seed", "calibrated N", "nominal cuffs N", "true cuffs N",
        "angles °", "velocities °/s", "bands hold %",
    )  # fmt: skip
    for r in found["rows"]:
        own = r["calibrated"]
        forces = (r[k] for k in ("calibrated", "uncalibrated", "floor"))
        cells = [f"{f['interaction_n']:.1f}" for f in forces]
        cells += [f"{own['angle_deg']:.1f}", f"{own['velocity_deg_s']:.1f}"]
        held = [c for f in r["coverage"] for c in f["interaction_n"].values()]
        cells.append(f"{100 * np.mean(held):.0f}")
        lines.append(_row(str(r["seed"]), *cells))
    return lines


def campaigns() -> list[str]:
    """Phases B, C1, C2 on the virtual laboratory."""
    found: dict[str, list[dict[str, float]]] = {"B": [], "C1": [], "C2": []}
    for seed in _SEEDS:
        with tempfile.TemporaryDirectory() as folder:
            study = dx.read_study(dx.write_campaign(folder, seed, processes=2))
            cuffs = dx.calibrate_interaction(study)
            trials = study.trials("prediction")
        found["B"].append(_means(cuffs.rmsd()))
        for phase, factor in (("C1", 1.0), ("C2", 1.4)):
            predicted = [
                dx.predict(study, t, cuffs, scale_interaction=factor)
                for t in trials
            ]
            scores = [p.rmsd(t) for p, t in zip(predicted, trials, strict=True)]
            found[phase].append(_means(scores))
    lines = _header("RMSD", "B", "the paper, B", "C1", "the paper, C1", "C2",
                    "C2 / C1")  # fmt: skip
    for row in found["B"][0]:
        b, c1, c2 = ([s[row] for s in found[p]] for p in ("B", "C1", "C2"))
        ratio = [y / x for x, y in zip(c1, c2, strict=True)]
        paper = _PAPER[row]
        lines.append(
            _row(row, _range(b), paper[0], _range(c1), paper[1], _range(c2),
                 _range(ratio) if row in _CUFFS.values() else "")
        )  # fmt: skip
    return lines


def opencap() -> list[str]:
    """Phase A on real rises; rises and sits predicted with what it found."""
    data = os.environ.get("DRAKE_EXO_DATA", _ROOT.parent / "shared" / "data")
    study, seated = (
        dx.read_study(
            _ROOT / "tests" / "studies" / f"opencap_{name}.yaml", data
        )
        for name in ("predict", "sit")
    )
    contact = dx.calibrate_foot_ground(study)
    trials, sits = (s.trials("prediction") for s in (study, seated))
    a = _means(contact.rmsd())
    c = [_means([dx.predict(study, t, contact).rmsd(t)]) for t in trials]
    down = _means([dx.predict(seated, t, contact).rmsd(t) for t in sits])
    sd, sd_down = (
        _means([spread(given, study.model.tree)]) for given in (trials, sits)
    )
    names = [t.name for t in trials]
    lines = _header("RMSD", "A, rises 1–3", "the paper, A", *names,
                    "one SD of measured " + ", ".join(names),
                    f"sits 1–{len(sits)}, mean", "one SD of measured sits",
                    "the paper, C1")  # fmt: skip
    for row in c[0]:
        calibrated = f"{a[row]:.1f}" if row in a else ""
        paper = _PAPER[row]
        lines.append(
            _row(row, calibrated, paper[2], *(f"{s[row]:.1f}" for s in c),
                 f"{sd[row]:.1f}", f"{down[row]:.1f}", f"{sd_down[row]:.1f}",
                 paper[1])
        )  # fmt: skip
    return lines


_TABLES = {
    "weights": weights,
    "intervals": intervals,
    "seeds": seeds,
    "campaigns": campaigns,
    "opencap": opencap,
}


def _benchmark(script: str, *options: str):
    """Run a script of benchmarks/; its results, read from JSON."""
    command = [sys.executable, _ROOT / "benchmarks" / script, *options]
    found = subprocess.run(
        [*command, "--json"], stdout=subprocess.PIPE, text=True, check=True
    )
    lines = found.stdout.splitlines()
    # Progress comes first.
    start = next(i for i, line in enumerate(lines) if line in ("[", "{"))
    return json.loads("\n".join(lines[start:]))


def _means(scores: list[dict]) -> dict[str, float]:
    """Title of a row -> mean over trials, of a signal's largest component."""
    found = {}
    for key, title in _SIGNALS.items():
        values = [s[key] for s in scores]
        if isinstance(values[0], dict):
            of = {n: np.mean([v[n] for v in values]) for n in values[0]}
            values = [max(of.values())] if of else []
        if values:
            found[title] = float(np.mean(values))
    for cuff, title in _CUFFS.items():
        known = [s["interaction_n"] for s in scores]
        values = [v[cuff] for v in known if v.get(cuff) is not None]
        if values:
            found[title] = float(np.mean(values))
    return found


def _range(values: list[float]) -> str:
    low, high = (f"{f(values):.3g}" for f in (min, max))
    return low if low == high else f"{low}–{high}"


def _header(*titles: str) -> list[str]:
    return [_row(*titles), _row(*("---" for _ in titles))]


def _row(*cells: str) -> str:
    return "| " + " | ".join(cells) + " |"


if __name__ == "__main__":
    main()
