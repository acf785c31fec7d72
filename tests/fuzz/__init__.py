"""Malformed input for everything that reads: messages, files, parameters, services; see __main__.py."""
