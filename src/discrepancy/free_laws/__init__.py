"""Laws left free: their basis, evidence, bands, and short formulas for them."""
