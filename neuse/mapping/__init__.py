"""Section IV-D: change detection, the object map, full shapes, and map files."""
