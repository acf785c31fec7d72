"""Malformed input for everything that reads: messages, files, parameters, services.  python tests/fuzz --help"""
