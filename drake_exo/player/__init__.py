"""A page that replays results: meshcat's viewer with a player of our own."""
