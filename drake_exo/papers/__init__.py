"""Tables and figures of the two papers that the project grew from."""
