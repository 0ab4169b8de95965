"""Fields that the blocks of a case file are made of."""

from dataclasses import field

from drake_exo.errors import InputError

Vector3 = tuple[float, float, float]
Vector2 = tuple[float, float]


def positive(unit: str, default=None):
    """A field above 0."""
    meta = {"unit": unit, "above": 0.0}
    return field(default=default, metadata=meta)


def not_negative(unit: str, default: float | None):
    """A field of at least 0."""
    return field(default=default, metadata={"unit": unit, "minimum": 0.0})


def exactly_one(block, names) -> None:
    """Refuse a block with none or several of the keys `names`."""
    given = [n for n in names if getattr(block, n) is not None]
    if len(given) != 1:
        raise InputError(
            f"give exactly one of {', '.join(names)}, not "
            f"{' and '.join(given) or 'none'}"
        )
