"""Camera, lamps, reflections, surfaces, optics, exposure and sensor: from positions to pixels."""
