"""`drake-exo batch`: many subjects, settings and steps with one command.

Finished tasks are not run again. After Ctrl-C, a machine that went down, or a
change in some of the files, give the same command to continue.
"""

import argparse
import os
import sys
from pathlib import Path

from drake_exo.batch.results import is_told, write_results
from drake_exo.batch.run import Batch, run_batch
from drake_exo.cli import positive
from drake_exo.errors import InputError
from drake_exo.files.output import read_json, stored
from drake_exo.jobs.engine import Processes

_PARSE = "drake_exo.cli:parse"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of the command."""
    parser.add_argument(
        "batch",
        type=Path,
        metavar="BATCH.yaml",
        help="batch file that lists what to run",
    )
    parser.add_argument(
        "--out", type=Path, required=True, help="folder for all results"
    )
    where = parser.add_mutually_exclusive_group()
    where.add_argument(
        "--workers",
        type=positive,
        default=os.cpu_count() or 1,
        metavar="N",
        help="processes at a time (default: one for each core)",
    )
    where.add_argument(
        "--scheduler",
        metavar="ADDRESS",
        help="use the workers of the Dask scheduler at tcp://HOST:PORT instead",
    )
    parser.add_argument(
        "--memory",
        type=positive,
        metavar="MB",
        help="memory that a task may use; tasks that need more are named "
        "(Linux only)",
    )


def run(args: argparse.Namespace) -> int:
    """Run what is not done yet; 0 if all of it holds, else 3."""
    if args.memory is not None and sys.platform != "linux":
        raise InputError(
            "--memory: only Linux bounds the memory of a process; leave it out"
        )

    def open_pool():
        if args.scheduler is None:
            return Processes(args.workers, args.memory)
        from drake_exo.jobs.engine import Cluster

        cluster = Cluster(args.scheduler, args.memory)
        print(f"{cluster.workers()} workers", flush=True)
        if cluster.dashboard:
            print(f"dashboard: {cluster.dashboard}", flush=True)
        return cluster

    def write(found: Batch) -> None:
        if not is_told(found):
            write_results(found)

    found = run_batch(args.batch, args.out, open_pool, _PARSE, write)
    print("\n".join([*unmatched(found), text_of(found)]))
    return found.exit_code


def text_of(found: Batch) -> str:
    """Counts, and a line for every task that failed or does not hold."""
    lines = [
        f"{task.name}: {row.verdict}: {row.sentence}" for task, row in found.bad
    ]
    good = len(found.tasks) - len(lines)
    lines.append(
        f"{good} of {len(found.tasks)} tasks hold, {found.fresh} run now; "
        f"results in {found.out}"
    )
    return "\n".join(lines)


def unmatched(found: Batch) -> list[str]:
    """A note for each step and --accept that no task of the step knows."""
    told: dict[tuple[str, str], list[bool]] = {}
    for task in found.tasks:
        path = found.out / task.name / "summary.json"
        is_done = found.outcomes[task.name].code in (0, 3)
        if not task.options or not is_done or not path.is_file():
            continue
        verdict = stored(read_json(path, "run the batch again"), path)
        for word in verdict.accepted if verdict else ():
            is_unknown = word in verdict.unmatched
            told.setdefault((task.step, word), []).append(is_unknown)
    return [
        f"note: options of {step}: --accept {word}: no check has that name"
        for (step, word), unknown in told.items()
        if all(unknown)
    ]
