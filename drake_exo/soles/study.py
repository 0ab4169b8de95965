"""The paper's five cases side by side: Table 2, shapes, stiffness, front."""

import time
from dataclasses import replace
from pathlib import Path

from drake_exo.output import prepare_output_folder, write_json
from drake_exo.soles.case import (
    Brick,
    Case,
    ContactBlock,
    CostBlock,
    LoadBlock,
    MaterialBlock,
    MeshBlock,
    OneFoot,
    OptimizeBlock,
    Pattern,
    Stage,
    StartBlock,
)
from drake_exo.soles.design import finish_on_own_mesh
from drake_exo.soles.optimise_command import optimise_case, print_row
from drake_exo.soles.study_report import finish

SIZE = (0.23, 0.13, 0.03)
AUTHORS_STEP = "soft_sole_hrp4/trajectory/one_foot_80kg_200Hz.txt"
# Sole's centre in that file's frame: see tests/cases/hrp4_neoprene.yaml.
_AUTHORS_ORIGIN = (1.274728354176543, -0.056000000000611)

# The paper's Table 2: c_tr and c_rot, initial and optimised.
TABLE_2 = {
    "1-Ref": (3.88e6, 8.06e5, 1.79e5, 1.74e5),
    "2-Rot": (3.88e6, 4.65e6, 1.79e5, 3.50e5),
    "3-Rubber": (5.39e6, 9.59e5, 2.48e5, 2.14e5),
    "4-Straight": (9.14e6, 1.02e6, 3.41e5, 5.84e4),
    "5-Fixed": (3.88e6, 1.21e6, 1.79e5, 1.16e5),
}

COARSE = (Stage((10, 6, 3), 24, 4e-5, 0.2, 16),)
FULL = (
    Stage((10, 6, 3), 40, 4e-5, 0.2, 40),
    Stage((14, 8, 4), 60, 1e-5, 0.1, 30),
    Stage((18, 12, 4), None, 5e-6, 0.1, 15),
)


def five_cases(load: LoadBlock, coarse: bool) -> list[Case]:
    """Table 1 of the paper with the given load."""
    stages = COARSE if coarse else FULL
    reference = Case(
        "1-Ref",
        MeshBlock(brick=Brick(SIZE, stages[-1].divisions)),
        MaterialBlock("neoprene"),
        load,
        ContactBlock(friction=0.8),
        StartBlock((-0.115, 0.0, -0.03), (-0.115, 0.0)),
        CostBlock(),
        OptimizeBlock(stages=stages),
    )
    return [
        reference,
        replace(reference, name="2-Rot", cost=CostBlock(weight=1000.0)),
        replace(reference, name="3-Rubber", material=MaterialBlock("butyl")),
        replace(
            reference, name="4-Straight", load=replace(load, straight=True)
        ),
        replace(
            reference,
            name="5-Fixed",
            optimize=replace(reference.optimize, fixed_top=True),
        ),
    ]


def run_study(args) -> int:
    """Optimise the five cases; 0 where every final design simulates."""
    root = args.data_root or Path(".")
    measured = args.data_root and (root / AUTHORS_STEP).is_file()
    if measured:
        load = LoadBlock(one_foot=OneFoot(AUTHORS_STEP, _AUTHORS_ORIGIN))
    else:
        load = LoadBlock(pattern=Pattern())
    print(f"load: {'the authors’ step' if measured else 'own pattern'}")
    rows, began = [], time.perf_counter()
    with prepare_output_folder(args.out, args.force) as out:
        for case in five_cases(load, args.coarse):
            rows.append(_one(out / case.name, case, root, args.mesh))
            print_row(rows[-1])
            _write(out, rows, measured, began)
        print(table(rows))
        _draw(out, rows)
        print(finish(out))
    print(f"results in {args.out}")
    return 1 if any(r["failed_steps"] for r in rows) else 0


def _one(folder: Path, case: Case, root: Path, mesh_file) -> dict:
    folder.mkdir(parents=True, exist_ok=True)
    step = case.load.load(root)
    mesh = case.read_mesh(root, mesh_file)
    step.check_inside(mesh.nodes[mesh.contact])
    if mesh_file is not None:
        case = finish_on_own_mesh(case)
    return optimise_case(folder, case, mesh, step, case.start_pose(mesh))


def _write(out, rows, measured, began) -> None:
    """After every case, so that an interrupted study keeps its cases."""
    write_json(
        out / "summary.json",
        {
            "cases": rows,
            "load": "authors' step" if measured else "walking pattern",
            "total_seconds": round(time.perf_counter() - began, 2),
        },
    )
    (out / "table.txt").write_text(table(rows) + "\n", encoding="utf-8")


def table(rows: list[dict]) -> str:
    """Table 2 with all its columns, the paper's beside ours."""
    head = (
        f"{'case':11s} {'':6s} {'c_tr ini':>9s} {'c_tr opt':>9s} "
        f"{'ratio':>6s} {'comp.':>7s} {'c_rot ini':>9s} {'c_rot opt':>9s} "
        f"{'ratio':>6s} {'comp.':>7s} {'c ini':>9s} {'c opt':>9s}"
    )
    lines = [head, "-" * len(head)]
    ours_1 = next((r for r in rows if r["name"] == "1-Ref"), None)
    for row in rows:
        tr0, tr, rot0, rot = TABLE_2[row["name"]]
        first = TABLE_2["1-Ref"]
        lines.append(
            _line(
                row["name"], "paper", row["weight"], (tr0, tr, rot0, rot),
                (first[1], first[3]),
            )
        )  # fmt: skip
        mine = (
            row["c_tr_initial"], row["c_tr"],
            row["c_rot_initial"], row["c_rot"],
        )  # fmt: skip
        base = (ours_1["c_tr"], ours_1["c_rot"]) if ours_1 else mine[1::2]
        lines.append(_line("", "ours", row["weight"], mine, base))
    return "\n".join(lines)


def _line(name, who, weight, values, base) -> str:
    tr0, tr, rot0, rot = values
    return (
        f"{name:11s} {who:6s} {tr0:9.2e} {tr:9.2e} {tr / tr0:6.3f} "
        f"{100 * (tr / base[0] - 1):+6.0f}% {rot0:9.2e} {rot:9.2e} "
        f"{rot / rot0:6.3f} {100 * (rot / base[1] - 1):+6.0f}% "
        f"{tr0 - weight * rot0:9.2e} {tr - weight * rot:9.2e}"
    )


def _draw(out: Path, rows) -> None:
    from drake_exo.soles.design_pictures import front_figure

    paper = {
        name: (tr / tr0, rot / rot0)
        for name, (tr0, tr, rot0, rot) in TABLE_2.items()
    }
    front_figure(out / "front.png", rows, paper)
