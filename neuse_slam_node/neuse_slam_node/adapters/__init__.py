"""Edges in the messages of other SLAMs; each module needs the message package that it is named after."""
