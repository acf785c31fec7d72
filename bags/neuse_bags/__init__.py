"""Bags in and out: simulate, convert, play, record, run the in-process pipeline, evaluate."""
