"""How a reader refuses a file."""

import pytest

from drake_exo.errors import InputError


def refusal(reader, path, *args) -> str:
    """Its one sentence, which names the file."""
    with pytest.raises(InputError) as caught:
        reader(path, *args)
    message = str(caught.value)
    assert path.name in message and "\n" not in message
    return message
