"""The table of free laws: what each is, which law it bends and by what, and its axes.

A row has a name and a description, then the bent law with its argument, and then the axes over the covered ranges. The
rest is what the law is: its symbol, its unit and the base parameters that it adds to. `law_kinds.FreeLaw` describes all
fields.
"""

from typing import Any

import numpy as np

from discrepancy.data.launch import HEADING, V0, B, normal_speed
from discrepancy.free_laws.law_kinds import ClipNumber, ImpactLaw, MotionLaw
from discrepancy.free_laws.ranges import over_heading, over_obliqueness, over_plane, over_range
from synthcam.tabulated_law import REFERENCE_SPEED_M_S

FRICTION: dict[str, Any] = {"symbol": "mu", "owners": (("sliding_friction", 0),)}
RESTITUTION: dict[str, Any] = {"symbol": "r", "owners": (("restitution", 0),)}
SPIN_TRANSFER: dict[str, Any] = {"symbol": "C", "owners": (("spin_transfer", 0),)}
ADDED_ROLLING: dict[str, Any] = {
    "symbol": "added rolling loss", "unit": "m/s^2", "centred": True,
    "part_names": ("constant", f"with the speed, at {REFERENCE_SPEED_M_S:g} m/s"),
}  # fmt: skip
FORCE: dict[str, Any] = {"symbol": "force over mass", "unit": "m/s^2", "part_names": ("x", "y"), "one_ball": True}
# fmt: off
LAWS = (
    # all along the motion
    MotionLaw("friction_speed", "Sliding friction over the slip speed", bends=("friction", "slip_speed"),
              over=lambda covered: over_range("slip speed", "u", covered.slips, 0.0), one_ball=True, **FRICTION),
    MotionLaw("friction_ball_speed", "Sliding friction over the ball's speed", bends=("friction", "velocity"),
              over=lambda covered: over_range("speed of the ball", "v", covered.speeds, 0.0), **FRICTION),
    MotionLaw("friction_heading", "Sliding friction over the direction of slip", bends=("friction", "slip"),
              over=lambda covered: over_heading(covered.slips), **FRICTION),
    MotionLaw("friction_place", "Sliding friction over the position", bends=("friction", "position"),
              over=lambda covered: over_plane(covered.slip_places, count=12), **FRICTION),
    MotionLaw("rolling_speed", "Rolling loss over the speed", bends=("rolling", "speed"),
              over=lambda covered: over_range("speed", "v", covered.roll_speeds, 0.0), one_ball=True,
              symbol="rolling loss", unit="m/s^2", owners=(("rolling_decel", 0), ("rolling_drag", 1))),
    MotionLaw("rolling_heading", "Rolling loss added by the direction of motion", bends=("rolling", "velocity"),
              over=lambda covered: over_heading(covered.roll_speeds), **ADDED_ROLLING),
    MotionLaw("rolling_place", "Rolling loss added by the position", bends=("rolling", "position"),
              over=lambda covered: over_plane(covered.roll_places), **ADDED_ROLLING),
    MotionLaw("force_speed", "Force along the motion over the speed", bends=("push", "velocity"),
              over=lambda covered: over_range("speed", "v", covered.speeds, 0.0), one_ball=True,
              symbol="force over mass along the motion", unit="m/s^2"),
    MotionLaw("force_velocity", "Force over the velocity (wind, curved paths)", bends=("push", "velocity"),
              over=lambda covered: over_plane(covered.velocities, "m/s"), **FORCE),
    MotionLaw("force_place", "Force over the position", bends=("push", "position"),
              over=lambda covered: over_plane(covered.places), **FORCE),
    MotionLaw("force_heading", "Force over the heading, proportional to the speed", bends=("push", "velocity"),
              over=lambda covered: over_heading(),
              symbol="force over mass and speed", unit="1/s", part_names=("along", "across")),
    # once in each collision
    ImpactLaw("restitution_speed", "Restitution over the normal speed", bends=("restitution", "normal_speed"),
              over=lambda covered: over_range("normal speed", "v_n", normal_speed(covered.launches)),
              at_impact=normal_speed, **RESTITUTION),
    ImpactLaw("restitution_obliqueness", "Restitution over |b|", bends=("restitution", "obliqueness"),
              over=over_obliqueness, at_impact=lambda launches: np.abs(launches[:, B]), **RESTITUTION),
    ImpactLaw("restitution_heading", "Restitution over the heading", bends=("restitution", "heading"),
              over=lambda covered: over_heading(), at_impact=lambda launches: launches[:, HEADING], **RESTITUTION),
    ImpactLaw("spin_transfer_speed", "Spin transfer over the contact speed", bends=("spin_transfer", "contact_speed"),
              over=lambda covered: over_range("contact speed", "v", covered.launches[:, V0]),
              at_impact=lambda launches: launches[:, V0], **SPIN_TRANSFER),
    ImpactLaw("spin_transfer_obliqueness", "Spin transfer over |b|", bends=("spin_transfer", "obliqueness"),
              over=over_obliqueness, at_impact=lambda launches: np.abs(launches[:, B]), **SPIN_TRANSFER),
    ImpactLaw("spin_transfer_heading", "Spin transfer over the heading", bends=("spin_transfer", "heading"),
              over=lambda covered: over_heading(), at_impact=lambda launches: launches[:, HEADING], **SPIN_TRANSFER),
    # a number for each clip
    ClipNumber("friction_clip", "Sliding friction of each clip", **FRICTION),
    ClipNumber("rolling_clip", "Rolling loss at rest of each clip",
               symbol="rolling loss at rest", unit="m/s^2", owners=(("rolling_decel", 0),)),
    ClipNumber("restitution_clip", "Restitution of each clip", **RESTITUTION),
    ClipNumber("spin_transfer_clip", "Spin transfer of each clip", **SPIN_TRANSFER),
    ClipNumber("scale_clip", "Error of the scale of each clip", symbol="scale error", owners=(("scale_error.e", 0),)),
    ClipNumber("clock_clip", "Error of the clock of each clip", symbol="clock error", owners=(("clock_error.e", 0),)),
)
# fmt: on
