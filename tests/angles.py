"""Tables of OpenSim's coordinates, angles in radians."""

_LENGTHS = ("_tx", "_ty", "_tz", "_x", "_y", "_z")


def in_radians(table):
    """All columns are angles but those whose names say that they are none."""
    angles = [name for name in table.names if not name.endswith(_LENGTHS)]
    return table.in_radians(angles)
