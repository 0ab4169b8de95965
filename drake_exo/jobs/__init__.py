"""Jobs that need each other, on processes of this machine or a cluster."""
