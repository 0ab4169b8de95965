"""Tables, figures and replays of results."""
