"""Which tests are meant for which file, and errors worth planting."""

# Folder or file -> tests; those of the longest fitting name run first.
TESTS = {
    "drake_exo/": ["tests/test_api.py", "tests/test_study.py"],
    "drake_exo/calibration/": ["tests/calibration"],
    "drake_exo/cli/": ["tests/test_cli.py", "tests/test_view.py"],
    "drake_exo/collocation/": ["tests/collocation", "tests/calibration"],
    "drake_exo/contact/": ["tests/contact", "tests/calibration"],
    "drake_exo/files/": ["tests/files", "tests/measurement"],
    "drake_exo/measurement/": ["tests/measurement"],
    "drake_exo/model/": ["tests/model", "tests/measurement"],
    "drake_exo/nlp/": ["tests/nlp", "tests/calibration"],
    "drake_exo/papers/": ["tests/report", "tests/soles/test_sole_study.py"],
    "drake_exo/player/": ["tests/player", "tests/report/test_replay.py"],
    "drake_exo/report/": ["tests/report"],
    "drake_exo/soles/": ["tests/soles"],
    "drake_exo/virtual_laboratory/": ["tests/virtual_laboratory"],
}

LISTED: dict[str, list[tuple[str, str]]] = {}
