"""Tracked frames to a change-aware object map, its changes and markers."""
