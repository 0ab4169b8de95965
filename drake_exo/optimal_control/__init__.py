"""Transcription and solution of optimal-control problems."""
