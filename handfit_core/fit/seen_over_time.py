"""What one of two views detected of a hand over time, and what it adds to the other view's observation."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from handfit_core.common.batch import Batch
from handfit_core.detect.keypoints import Landmarked
from handfit_core.fit.observation import Observation, SecondView
from handfit_core.fit.settings import VIEWS
from handfit_core.geometry.camera import PlacedCamera


@dataclass(frozen=True, eq=False)
class SeenOverTime(Batch):
    """The landmarks of a hand in the N frames of a view in which it was detected."""

    times: np.ndarray
    """(N,) seconds, increasing"""
    seen: Landmarked
    """N hands, pixels"""
    fps: float
    """of the view"""

    @cached_property
    def extent(self) -> float:
        """Median size of the hand in the picture, pixels."""
        return float(np.median(np.ptp(self.seen.pixels, axis=1).max(axis=1)))

    def seen_at(self, times: np.ndarray) -> np.ndarray:
        """(M,) bool: true where there is a detection near those times (M,), in seconds."""
        after = np.clip(np.searchsorted(self.times, times), 0, len(self.times) - 1)
        before = np.maximum(after - 1, 0)
        away = np.minimum(np.abs(self.times[after] - times), np.abs(self.times[before] - times))
        inside = (times >= self.times[0]) & (times <= self.times[-1])
        return inside & (away * self.fps <= VIEWS.seen_within)

    @cached_property
    def _course(self):
        """Cubic splines of the pixels."""
        from scipy.interpolate import CubicSpline  # slow to load

        return CubicSpline(self.times, self.seen.pixels, axis=0)

    def at(self, times: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Pixels (M, 21, 2) and their speed (M, 21, 2) per second, at times (M,)."""
        times = np.clip(times, self.times[0], self.times[-1])
        if len(self) == 1:
            pixels = self.seen.pixels[np.zeros(len(times), dtype=int)]
            return pixels, np.zeros_like(pixels)
        return self._course(times), self._course(times, 1)

    def nearest(self, times: np.ndarray) -> np.ndarray:
        """(M,) rows that are nearest to those times (M,)."""
        return np.round(np.interp(times, self.times, np.arange(len(self.times)))).astype(int)

    @cached_property
    def sigma(self) -> float:
        """Expected error of a landmark in the picture, pixels."""
        return VIEWS.pixel_sigma * self.extent

    @cached_property
    def sigmas(self) -> np.ndarray:
        """(N, 21, 2) expected errors of landmarks, pixels: `sigma`, and more of points that the detector
        doubts, such as hidden ones."""
        own = self.seen.pixel_sigma / np.median(self.seen.pixel_sigma)
        return self.sigma * np.maximum(own, 1.0)

    def sigmas_at(self, times: np.ndarray) -> np.ndarray:
        """(M, 21, 2) `sigmas` at times (M,), infinite where there is no detection near."""
        return np.where(self.seen_at(times)[:, None, None], self.sigmas[self.nearest(times)], np.inf)

    def in_second_view(
        self, plain: Observation, sigmas: np.ndarray, moments: np.ndarray, camera: PlacedCamera
    ) -> Observation:
        """The observation `plain` of M hands by the first view, to which what this one saw through `camera`
        at `moments` (M,) is added. Where both see the hand, points count with the first view's `sigmas`
        (M, 21, 2), and depth less."""
        saw, (pixels, _) = self.seen_at(moments)[:, None], self.at(moments)
        return replace(
            plain,
            pixel_sigma=np.where(saw[..., None], sigmas, plain.pixel_sigma),
            depth_sigma=plain.depth_sigma * np.where(saw, VIEWS.fit_depth_factor, 1.0),
            second=SecondView.through(camera, pixels, self.sigmas_at(moments)),
        )
