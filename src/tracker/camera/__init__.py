"""The camera and its film: geometry, lens, sensor, camera.json, and the reading of frames."""
