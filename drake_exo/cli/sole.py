"""The command `drake-exo sole`: simulate and optimise compliant soles."""

import time
from argparse import ArgumentParser
from contextlib import contextmanager, suppress
from pathlib import Path
from threading import Event, Thread

from drake_exo import soles
from drake_exo.cli import add_accept, add_out, count, positive
from drake_exo.errors import InputError
from drake_exo.files.output import (
    NOT_SOLVED_CODE,
    STOPPED_CODE,
    OutputFolder,
    Progress,
    Verdict,
    check_new,
    joined_mark,
    prepare_output_folder,
    stored,
    write_json,
)
from drake_exo.papers import de_magistris as paper
from drake_exo.soles import finite_strain as strains
from drake_exo.soles.optimize.files import (
    CHECKPOINT,
    SUMMARY,
    read_checkpoint,
    read_summary,
)
from drake_exo.soles.optimize.search import front_checks

_QUIET = 2.0  # longest time without a line [s]
_FOLDERS = "folder of 'sole optimize' or 'sole study'"
_LIMITS = (
    "limits on stability, tilt and strain: all keeps the case's, none leaves "
    "them out as in the paper"
)
_ARGUMENTS = {
    "case": {
        "metavar": "CASE.yaml",
        "type": Path,
        "help": "case file: sole, material, load and, where given, limits",
    },
    "source": {"metavar": "DIR", "type": Path},
    "--mesh": {
        "type": Path,
        "help": "mesh file to use instead of the case's",
    },
    "--data-root": {
        "type": Path,
        "help": "folder that the case's paths are relative to "
        "(default: the case file's)",
    },
    "--limits": {
        "choices": ("all", "none"),
        "default": "all",
        "help": f"{_LIMITS} (default: all)",
    },
    "--iterations": {
        "type": count,
        "metavar": "N",
        "help": "largest number of iterations of the last stage (default: the "
        "case's)",
    },
    "--jobs": {"type": positive, "default": 2},
}


def add_arguments(sole: ArgumentParser) -> None:
    """Add the arguments of the command."""
    jobs = sole.add_subparsers(dest="job", required=True)

    def job(name: str, run, help: str):
        told = f"`drake-exo sole {name}`: {help}."
        parser = jobs.add_parser(name, help=help, description=told)
        parser.set_defaults(run=run)
        return parser

    one = "simulate a sole while the foot's load moves over it"
    parser = job("simulate", _simulate, one)
    _add_case(parser)
    add_accept(parser)
    parser = job("optimize", _optimize, "find the best shape of a case's sole")
    _add_case(parser)
    resumed = "go on from an earlier run's checkpoint, into another --out"
    parser.add_argument("--resume", type=Path, metavar="DIR", help=resumed)
    _add(parser, "--limits", "--iterations")
    add_accept(parser)
    starts = "starts (or walks) to search at a time (default: 2)"
    _add(parser, "--jobs", help=starts)
    five = "optimise De Magistris's five cases, beside Table 2 of the paper"
    parser = job("study", _study, five)
    coarse = "only two stages on a coarse mesh, for a first look (two minutes)"
    parser.add_argument("--coarse", action="store_true", help=coarse)
    both = f"{_LIMITS}, both runs it both ways (default: all)"
    _add(parser, "--limits", choices=("all", "none", "both"), help=both)
    _add(parser, "--iterations")
    add_accept(parser)
    front = "also find the least c_tr above floors of c_rot, on a coarse mesh"
    parser.add_argument("--front", action="store_true", help=front)
    at_once = "stages of starts to run at a time (default: 2)"
    _add(parser, "--jobs", help=at_once)
    _add(parser, "--mesh", help="mesh file to use instead of the brick")
    root = (
        f"folder that holds the authors' step, {paper.AUTHORS_STEP} "
        "(default: none; the load is our own walking pattern)"
    )
    _add(parser, "--data-root", help=root)
    add_out(parser, required=True)
    front = (
        "find the least stiffness at heel strike (c_tr) above eight floors of "
        "the stiffness against tilting (c_rot)"
    )
    parser = job("front", _front, front)
    _add_case(parser)
    _add(parser, "--limits")
    add_accept(parser)
    strain = "compare heel strike of designs in finite and in small strain"
    parser = job("strain", _strain, strain)
    _add_source(parser, f"{_FOLDERS}, or a case file")
    _add(parser, "--mesh", "--data-root")
    again = "draw a study's or a design's pictures again, and report.html"
    _add_source(job("report", _report, again), _FOLDERS)
    spheres = "fit a smooth contact law of a few spheres to a simulated sole"
    parser = job("reduce", _reduce, spheres)
    _add(parser, "source", help="folder of 'sole simulate' or 'sole optimize'")
    parser.add_argument(
        "--spheres", type=count, default=4, help="how many to fit (default: 4)"
    )
    planar = (
        "fit to pitch and forward motion alone, for a step that does not roll "
        "sideways"
    )
    parser.add_argument("--planar", action="store_true", help=planar)
    law = "law to write, a .yaml file; a .csv of its samples goes beside it"
    add_out(parser, required=True, help=law)


def _add(parser, *names: str, **changed) -> None:
    """Add some of `_ARGUMENTS`, with changes for this command."""
    for name in names:
        parser.add_argument(name, **_ARGUMENTS[name] | changed)


def _add_case(parser) -> None:
    """Add the case file, its --mesh and --data-root, and --out."""
    _add(parser, "case", "--mesh", "--data-root")
    add_out(parser, required=True)


def _add_source(parser, help: str) -> None:
    """Add the folder of an optimisation, and --out."""
    _add(parser, "source", help=help)
    again = "folder for the results (default: DIR)"
    add_out(parser, "replace earlier results", help=again)


def _read_case(args, path: Path) -> soles.Case:
    """Read a case file; a study of recordings is looked for beside it."""

    def read_step(study: str, *which):
        # The exoskeleton half is loaded only if a case asks for it.
        from drake_exo.study import read_study

        return read_study(path.parent / study, args.data_root).step(*which)

    with _ticking(_progress(str(path)), "reading and meshing"):
        return soles.Case.read(path, args.data_root, args.mesh, read_step)


def _case(args) -> soles.Case:
    """The case file with the command's options."""
    case = _read_case(args, args.case)
    if getattr(args, "limits", "all") == "none":
        case = case.without_limits()
    return case.with_iterations(getattr(args, "iterations", None))


def _out_or_source(args, name: str) -> OutputFolder:
    """The folder --out, or the source, if it has no such file already."""
    if args.out is not None:
        return prepare_output_folder(args.out, args.force, reads=[args.source])
    if (args.source / name).exists() and not args.force:
        raise InputError(
            f"{args.source}: already holds {name}; give --out, or replace "
            "earlier results with --force"
        )
    return prepare_output_folder(args.source, resume=True)


def _out_of(args, case: soles.Case) -> OutputFolder:
    """The folder --out, which must hold none of the case's files."""
    root = args.data_root or args.case.parent
    named = (root / file for file in case.settings.files)
    resumed = getattr(args, "resume", None)
    reads = [args.case, args.mesh, resumed, *named]
    resume = False if "resume" in args else None
    return prepare_output_folder(args.out, args.force, resume, reads)


def _progress(name: str, total: int | None = None) -> Progress:
    return Progress(name, total, interval_seconds=_QUIET)


@contextmanager
def _ticking(progress: Progress, *said):
    """Say so, and then the newest news, again and again until it is done."""
    progress.update(*said)
    ended = Event()

    def tick() -> None:
        with suppress(BrokenPipeError):  # which the command itself will meet
            while not ended.wait(_QUIET / 4):
                progress.repeat()

    thread = Thread(target=tick, daemon=True)
    thread.start()
    try:
        yield
    finally:
        ended.set()
        thread.join()


def _simulate(args) -> int:
    """Simulate one case; the exit code of its verdict."""
    began = time.perf_counter()
    case = _case(args)
    seconds = {"mesh_seconds": round(time.perf_counter() - began, 4)}
    tets, samples = len(case.mesh.tets), len(case.load.times)
    progress = _progress(case.name, samples)
    folder = _out_of(args, case)
    with folder as out:
        # A fine mesh takes a minute before its first sample.
        print(f"{case.name}: {tets} tets, {samples} samples", flush=True)
        step = case.simulate(lambda done, _: progress.update("samples", done))
        with _ticking(progress, "pictures", samples):
            verdict = step.write(out, seconds, args.accept)
        folder.end(verdict.exit_code)
    print(
        f"{case.name}: c_tr {step.c_tr:.4g} N/m, c_rot {step.c_rot:.4g} "
        f"N·m/rad, c {step.c:.4g}"
    )
    print(verdict.text())
    print(f"{case.name}: results in {folder.path}")
    return verdict.exit_code


def _optimize(args) -> int:
    """Optimise one case; the exit code of its verdict."""
    case = _case(args)
    progress = _progress(case.name)
    say = progress.update
    # A bad one is refused before a folder is made.
    resume = read_checkpoint(args.resume) if args.resume else None
    folder = _out_of(args, case)
    with folder as out:
        try:
            with _ticking(progress, "searching"):
                design = case.optimize(out, say, resume, args.jobs)
            with _ticking(progress, "checking the design"):
                row = design.write(out, say, args.accept)
        except KeyboardInterrupt:
            way = "before the first checkpoint; begin again"
            if any(out.rglob(CHECKPOINT)):
                way = f"go on with --resume {out} and another --out"
            print(f"{case.name}: stopped; {way}", flush=True)
            raise
        verdict = stored(row)
        folder.end(verdict.exit_code)
    print(paper.line(row))
    print(verdict.text())
    print(f"{case.name}: results in {folder.path}")
    return verdict.exit_code


def _study(args) -> int:
    """Optimise the paper's five cases; exit code of all verdicts together."""
    with _ticking(_progress("study"), "reading and meshing"):
        study = paper.Study.read(
            args.data_root, args.mesh, args.coarse, args.limits, args.iterations
        )
    print(f"load: {study.source}")
    folder = prepare_output_folder(args.out, args.force, reads=[args.mesh])
    with folder as out:
        verdict, text = study.run(out, args.jobs, args.front, args.accept)
        print(text)
        with _ticking(_progress("study"), "pictures"):
            text = paper.report(out, soles.find_designs(out), out)
        print(text)
        folder.end(verdict.exit_code)
    print(verdict.text())
    print(f"results in {folder.path}")
    return verdict.exit_code


def _front(args) -> int:
    """Compute the front of one case; the exit code of its verdict."""
    case = _case(args)
    folder = _out_of(args, case)
    with folder as out:
        say = _progress(f"{case.name}, front").update
        points, stopped = [], False
        try:
            soles.pareto_front(case, paper.FLOORS, say, points=points)
        except KeyboardInterrupt:
            if not points:
                raise
            stopped = True
        verdict = Verdict(tuple(front_checks(points)), tuple(args.accept))
        summary = {"name": case.name, "front": points} | verdict.summary()
        write_json(out / SUMMARY, summary)
        paper.draw_pareto_front(out, {"front": points}, mark=verdict.mark)
        code = STOPPED_CODE if stopped else verdict.exit_code
        folder.end(code)
    print(paper.front_table(points))
    print(verdict.text())
    print(f"{case.name}: results in {folder.path}")
    if stopped:
        print(f"stopped by the user after {len(points)} points")
    return code


def _strain(args) -> int:
    """Write and print the table; 1 if some sample has no equilibrium."""
    if args.source.is_dir():
        if args.mesh or args.data_root:
            raise InputError(
                "sole strain: --mesh and --data-root are for a case file; "
                f"leave them out, since {args.source} holds mesh and load"
            )
        designs = soles.find_designs(args.source)
        setups = [design.setup for design in designs]
        mark = joined_mark({design.name: design.mark for design in designs})
    else:
        setups, mark = [_read_case(args, args.source)], ""
        if args.out is None:
            raise InputError("sole strain: give --out with a case file")
    folder = _out_or_source(args, strains.TABLE)
    with folder as out:
        found = {}
        for setup in setups:
            progress = _progress(setup.name)
            with _ticking(progress, "simulating heel strike"):
                judged = soles.compare_strains(setup, progress.update)
            found[setup.name] = judged
        print(strains.write_table(out, found, mark))
        _note(out, found)
    failed = any(sole["failures"] for sole in found.values())
    print(f"results in {folder.path}")
    return NOT_SOLVED_CODE if failed else 0


def _reduce(args) -> int:
    """Fit spheres, print and write; 1 if the fit misses its goals."""
    # SciPy's optimiser takes a moment to load.
    from drake_exo.contact.reduction import SoleLaw, reduce_sole

    if args.out.is_dir() or args.out.suffix not in (".yaml", ".yml"):
        raise InputError(f"{args.out}: give a .yaml file for --out")
    rows = args.out.with_suffix(".csv")
    for path in (args.out, rows):
        check_new(path, args.force)
    if rows.exists() and not args.out.exists():
        raise InputError(
            f"{rows}: is not the table of an earlier law; give another name "
            "for --out"
        )
    if args.out.exists():
        try:
            SoleLaw.read(args.out)
        except InputError as error:  # a case, say
            raise InputError(
                f"{args.out}: is not an earlier law; give another name for "
                "--out"
            ) from error
    samples = soles.sole_samples(args.source)
    fitting = f"fitting {args.spheres} spheres"
    with _ticking(_progress(str(args.source)), fitting):
        found = reduce_sole(samples, args.spheres, args.planar)
    found.write(args.out)
    where = "the plane" if args.planar else "space"
    spin = support = ""
    if not args.planar:
        spin = f", friction's free moment {100 * found.spin_error:.0f} %"
        support = (
            f"; they support {max(100 * found.support_share, 0.0):.0f} % of "
            "the way to the sole's edge"
        )
    print(
        f"{args.spheres} spheres in {where}: force "
        f"{100 * found.force_error:.1f} % of the largest, centre of "
        f"pressure {1e3 * found.cop_error:.1f} mm where loaded{spin} (RMS)"
        f"{'' if found.is_near else ', too far: try more spheres'}{support}; "
        f"{args.out}, every sample in {rows}"
    )
    return 0 if found.is_near else 1


def _note(out: Path, found: dict[str, dict]) -> None:
    """Add finite-strain numbers to summary.json, made if it is not there."""
    key = "finite_strain"
    summary = read_summary(out) if (out / SUMMARY).is_file() else {}
    if "cases" in summary:
        for row in summary["cases"]:
            row[key] = found.get(row["name"], row.get(key))
    elif len(found) == 1 and summary:
        summary[key] = next(iter(found.values()))
    else:
        summary["cases"] = [{"name": n, key: f} for n, f in found.items()]
    write_json(out / SUMMARY, summary)


def _report(args) -> int:
    """Draw pictures and report.html again, and print the table."""
    designs = soles.find_designs(args.source)
    drawing = _ticking(_progress(str(args.source)), "pictures")
    with _out_or_source(args, paper.SOLES) as out, drawing:
        text = paper.report(out, designs, args.source)
    if text:
        print(text)
    print(f"pictures in {args.out or args.source}")
    return 0
