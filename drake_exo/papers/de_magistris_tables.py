"""Tables of a study: Table 2 beside the paper's, and how sure ours is."""

from drake_exo.papers.de_magistris_cases import TABLE_2


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


def paper_cost(row: dict) -> float:
    """The paper's optimum rescaled to our brick: c to beat."""
    tr0, tr, rot0, rot = TABLE_2[row["name"]]
    c_tr = row["c_tr_initial"] * tr / tr0
    return c_tr - row["weight"] * row["c_rot_initial"] * rot / rot0


def certainty_table(rows: list[dict]) -> str:
    """C to beat, optimality, and the design judged more strictly.

    Columns: c and the paper's rescaled; IPOPT's error and largest
    complementarity; change of c by the exact law from a cold start; change
    of c on a finer mesh and the brick's own; largest strain, tilt, stability.
    """
    head = (
        f"{'case':11s} {'c':>10s} {'paper':>10s} {'error':>8s} {'compl.':>8s} "
        f"{'exact law':>9s} {'finer':>7s} {'brick':>7s} {'strain':>6s} "
        f"{'tilt':>5s} {'stable':>6s} {'s':>6s}"
    )
    lines = [head, "-" * len(head)]
    for row in rows:
        finer = row.get("finer") or {}
        lines.append(
            f"{row['name']:11s} {row['c']:10.3e} {paper_cost(row):10.3e} "
            f"{_number(row.get('optimality_error'), '8.1e')} "
            f"{_number(row.get('complementarity'), '8.1e')} "
            f"{_percent(row.get('exact_change'), 9)} "
            f"{_percent(finer.get('change'), 7)} "
            f"{_percent(finer.get('brick_change'), 7)} "
            f"{row['max_strain']:6.2f} {row['tilt_max_deg']:5.1f} "
            f"{'yes' if row['stable'] else 'no':>6s} {row['seconds']:6.0f}"
        )
    return "\n".join(lines)


def _number(value, form: str) -> str:
    if value is None:
        return f"{'-':>{form.split('.')[0]}s}"
    return f"{value:{form}}"


def _percent(value, width: int) -> str:
    if value is None:
        return f"{'-':>{width}s}"
    return f"{100 * value:+{width - 1}.2f}%"
