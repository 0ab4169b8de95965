"""Readers and writers, one for each format, and folders of results."""
