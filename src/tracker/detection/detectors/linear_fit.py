"""One linear fit of a spot on a tilted plane of light, about each centroid: for crowds, where full fits take too long.

A ball is brighter on one side, and its neighbours shine beside its glint. Both shift the centroid by up to a tenth of a
pixel, in all frames towards the same side. The fit tells such light from the glint.
"""

from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from synthcam_shared.arrays import Array, Flags, Ints
from tracker.detection.detector import View
from tracker.detection.glints import Glints, PositionFlag
from tracker.detection.likelihood.cramer_rao import compute_glint_shape
from tracker.detection.likelihood.neighbours import find_repeated
from tracker.detection.spot_centroids import SpotCentroids


class LinearFit:
    """Least squares of the spot, its two derivatives and a plane, with the noise of each pixel."""

    def __init__(self, view: View) -> None:
        self.sensor, self.sigma, self.noise = view.camera.sensor, view.sigma, view.plate.noise
        self.find_centroids = SpotCentroids(view)
        self.half = self.find_centroids.half
        # A larger window would hold glints of neighbours.
        self.largest_half = max(self.half, round(0.75 * view.camera.diameter_px))

    def __call__(self, frame: NDArray[Any]) -> Glints:
        """Glints of one frame."""
        found, half = self.find_centroids(frame), self.half
        if len(found) == 0:
            return found
        found, is_cut = self._place(frame, found, half)
        largest_half, is_long = min(self.largest_half, (min(frame.shape) - 1) // 2), is_cut.any()
        while is_cut.any() and half + 2 <= largest_half:
            half += 2
            cut = np.flatnonzero(is_cut)
            rows, columns = self._find_pixels(frame, found.take(cut), half)
            wide, is_cut[cut] = self._place(frame, self.find_centroids.measure(frame, rows, columns, half), half)
            found.put(cut, wide)
        # The middle of a smear that no window holds may be anywhere in the largest; so for candidates at its ends.
        apart = np.abs(found.xy[:, None] - found.xy[is_cut]).max(axis=2).min(axis=1, initial=np.inf)
        is_lost = apart <= half
        found.cov[is_lost] += (half + 0.5) ** 2 / 3 * np.eye(2)
        found.flags[is_lost] |= PositionFlag.MISFIT
        # A long smear has several candidates, which are then placed at its middle.
        return found.take(~find_repeated(found, self.find_centroids.search.apart / 2)) if is_long else found

    def _find_pixels(self, frame: NDArray[Any], found: Glints, half: int) -> tuple[Ints, Ints]:
        """Rows and columns of the pixels (n,) nearest to glints, windows about which lie in the frame."""
        rows, columns = (
            np.clip(np.rint(at).astype(np.int64), half, size - 1 - half)
            for at, size in zip((found.y, found.x), frame.shape, strict=True)
        )
        return rows, columns

    def _place(self, frame: NDArray[Any], found: Glints, half: int) -> tuple[Glints, Flags]:
        """Place glints by fits in windows 2 half + 1 pixels wide; and tell which of them seem longer than that."""
        most_px = 0.5  # of a shift by the fit, beyond which the centroid stays, with that error
        span = np.arange(-half, half + 1)
        rows, columns = self._find_pixels(frame, found, half)
        counts = frame[(rows[:, None] + span)[:, :, None], (columns[:, None] + span)[:, None, :]].astype(float)
        off = np.column_stack([found.x - columns, found.y - rows])
        blurs = self._find_blurs(counts - found.background[:, None, None], off)
        shift, cov = self._fit(counts, off, blurs)
        good = np.hypot(*shift.T) < most_px
        shift = np.where(np.isfinite(shift), np.clip(shift, -most_px, most_px), most_px)
        # Standard errors by light that a plane does not describe; it lasts from frame to frame. They are from eight
        # rendered crowds with balls of 9 to 40 px and spots of width 0.7 to 1.6 px.
        curved, uneven = 0.15, 0.003  # shares of the shift that the fit removes, and of the width of a spot
        lasting = np.hypot(shift * np.where(good, curved, 1.0)[:, None], uneven * self.sigma)
        fixed = lasting[:, :, None] ** 2 * np.eye(2)
        own = np.where(good[:, None, None], cov, found.cov)
        moved = np.where(good[:, None], shift, 0.0)
        length = np.hypot(*blurs.T)
        # A smear whose window was widened before may reach beyond one end of it only.
        aside = np.where(half > self.half, np.abs((off * blurs).sum(axis=1)) / np.maximum(length, 1e-9), 0.0)
        is_cut = length / 2 + aside > half + 0.5 - self.sigma
        return replace(found, x=found.x + moved[:, 0], y=found.y + moved[:, 1], cov=own + fixed, fixed=fixed), is_cut

    def _fit(self, counts: Array, off: Array, blurs: Array) -> tuple[Array, Array]:
        """Shifts (n, 2), px, from positions `off` to those of the fits, and covariances by noise; NaN without light."""
        n, half = len(off), counts.shape[1] // 2
        spot, span = compute_glint_shape(off, blurs, self.sigma, half), np.arange(-half, half + 1)
        plane = np.stack([np.ones((len(span), len(span))), *np.meshgrid(span, span)])
        spots = np.stack([spot.value, spot.by_x, spot.by_y], axis=1)
        parts = np.concatenate([spots, np.broadcast_to(plane, (n, *plane.shape))], axis=1).reshape(n, 6, -1)
        weight = np.where(counts < self.sensor.ceiling, 1 / self.sensor.variance(counts), 0.0).reshape(n, 1, -1)
        cov = np.linalg.pinv((parts * weight) @ parts.swapaxes(1, 2), hermitian=True)
        flux, *moment = (cov @ (parts * weight) @ counts.reshape(n, -1, 1))[..., 0].T[:3]
        flux = np.where(flux > 0, flux, np.nan)
        return np.stack(moment, axis=1) / flux[:, None], cov[:, 1:3, 1:3] / (flux**2)[:, None, None]

    def _find_blurs(self, light: Array, off: Array) -> Array:
        """Displacements (n, 2) during the exposure, px: a line of that length has the spot's second moments."""
        weight = np.maximum(light - 2.0 * self.noise, 0.0)
        weight /= np.maximum(weight.sum(axis=(1, 2), keepdims=True), 1e-9)
        half = light.shape[1] // 2
        span = np.arange(-half, half + 1)
        dx, dy = ((span - at[:, None]) for at in off.T)
        xx, yy = (weight.sum(axis=1) * dx**2).sum(axis=1), (weight.sum(axis=2) * dy**2).sum(axis=1)
        xy = (weight * dy[:, :, None] * dx[:, None, :]).sum(axis=(1, 2))
        longer = np.hypot(xx - yy, 2 * xy)  # by which the variance along the longer axis exceeds the other
        length, angle = np.sqrt(12 * longer), np.arctan2(2 * xy, xx - yy) / 2
        return np.asarray(length[:, None] * np.column_stack([np.cos(angle), np.sin(angle)]))
