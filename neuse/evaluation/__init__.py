"""How good was a run: ATE, RPE, changes, objects, edge NEES and stage times; as JSON, HTML and pictures."""
