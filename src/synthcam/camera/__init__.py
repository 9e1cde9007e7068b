"""How a camera sees the balls: geometry, lamps, reflections, surfaces, optics, exposure, sensor."""
