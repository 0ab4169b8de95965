"""From a laboratory's files to trials."""
