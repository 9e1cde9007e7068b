"""One model fitted to all collisions: prediction, derivatives, Gauss-Newton, significance."""
