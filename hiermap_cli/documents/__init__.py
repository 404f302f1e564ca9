"""The files that go out: model.json, report.json, trajectories, map.svg, and their schemas."""
