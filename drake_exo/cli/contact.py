"""`drake-exo contact`: draw the contact laws, Figures 8 and 9 of the paper."""

from argparse import ArgumentParser, Namespace

from drake_exo.cli import add_out
from drake_exo.errors import InputError, check_fields
from drake_exo.files.output import prepare_output_folder
from drake_exo.report.figures import ContactCurves, write_figures


def add_arguments(parser: ArgumentParser) -> None:
    """Add the arguments of the command."""
    add_out(parser, required=True, help="folder for the figures")
    for name, item in ContactCurves.__dataclass_fields__.items():
        unit = item.metadata["unit"]
        parser.add_argument(
            f"--{name.replace('_', '-')}",
            type=float,
            default=item.default,
            help=f"default {item.default:g} {unit}".rstrip(),
        )


def run(args: Namespace) -> None:
    """Draw both figures into --out."""
    curves = ContactCurves(
        **{name: getattr(args, name) for name in vars(ContactCurves())}
    )
    check_fields(curves, "contact curves")
    if curves.dynamic_friction > curves.static_friction:
        raise InputError(
            "contact curves: dynamic friction is above static friction; "
            "give a lower --dynamic-friction"
        )
    with prepare_output_folder(args.out, args.force) as folder:
        for file in write_figures(folder, curves):
            print(args.out / file.name)
