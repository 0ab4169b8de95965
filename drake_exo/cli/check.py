"""`drake-exo check`: read and clean a study's files, report their quality.

It also judges whether the recordings can be what the study says they are, and
ends with exit code 3 if a check fails.
"""

import argparse
from contextlib import nullcontext
from pathlib import Path

from drake_exo.cli import add_accept, add_out, add_study
from drake_exo.files.output import (
    Progress,
    Verdict,
    prepare_output_folder,
    save_figure,
    write_json,
    write_text,
)
from drake_exo.measurement.quality import Quality, text_of
from drake_exo.study import RecordedStudy, read_study


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of the command."""
    add_study(parser)
    add_out(parser, help="write report, pictures and trials to this folder")
    add_accept(parser)


def run(args: argparse.Namespace) -> int:
    """Print report and checks; write them with pictures to --out, if given."""
    study = read_study(args.study, args.data_root)
    folder = nullcontext()
    if args.out is not None:
        folder = prepare_output_folder(args.out, args.force, reads=study.reads)
    with folder as out:
        quality = study.quality()
        verdict = Verdict(quality.checks, tuple(args.accept))
        print(text_of(quality))
        print(verdict.text())
        if out is not None:
            _write(out, study, quality, verdict)
    if args.out is not None:
        print(f"report in {args.out}")
    return verdict.exit_code


def _write(
    out: Path, study: RecordedStudy, quality: Quality, verdict: Verdict
) -> None:
    from drake_exo.report.figures import quality_figure

    text = f"{text_of(quality)}\n{verdict.text(color=False)}"
    write_text(out / "quality.txt", text, verdict.mark)
    write_json(
        out / "quality.json",
        {
            **quality.summary(),
            "standing": study.subject.report,
            **verdict.summary(),
        },
    )
    summary = {"subject": study.name} | verdict.summary()
    write_json(out / "summary.json", summary)
    trials = study.trials()
    progress = Progress("drawing", total=len(trials))
    for i, (trial, found) in enumerate(
        zip(trials, quality.trials, strict=True)
    ):
        trial.save(out / trial.name)
        figure = quality_figure(trial, found)
        save_figure(out / f"{trial.name}.png", figure, verdict.mark)
        progress.update(trial.name, done=i + 1)
