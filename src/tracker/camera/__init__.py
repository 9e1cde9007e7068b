"""What is known of a camera and its film: geometry, lens, sensor, camera.json, frames."""
