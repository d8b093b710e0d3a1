"""A view's detections of a hand over time, and their part in the observation of another view."""

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
    """(N,) seconds, increasing: when each detection was made"""
    seen: Landmarked
    """The landmarks of the N detections, in pixels of the view"""
    fps: float
    """Frames per second of the view"""

    @cached_property
    def extent(self) -> float:
        """Median size of the hand in the picture, pixels."""
        return float(np.median(np.ptp(self.seen.pixels, axis=1).max(axis=1)))

    def seen_at(self, times: np.ndarray) -> np.ndarray:
        """Tell at which of the times (M,), in seconds, there is a detection near: (M,) bool."""
        after = np.clip(np.searchsorted(self.times, times), 0, len(self.times) - 1)
        before = np.maximum(after - 1, 0)
        away = np.minimum(np.abs(self.times[after] - times), np.abs(self.times[before] - times))
        inside = (times >= self.times[0]) & (times <= self.times[-1])
        return inside & (away * self.fps <= VIEWS.seen_within)

    @cached_property
    def _course(self):
        """Cubic splines over time through the pixels of the landmarks."""
        from scipy.interpolate import CubicSpline  # slow to load

        return CubicSpline(self.times, self.seen.pixels, axis=0)

    def at(self, times: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return the landmarks (M, 21, 2) in pixels, and their speeds (M, 21, 2) in pixels per second, at
        times (M,) in seconds."""
        times = np.clip(times, self.times[0], self.times[-1])
        if len(self) == 1:
            pixels = self.seen.pixels[np.zeros(len(times), dtype=int)]
            return pixels, np.zeros_like(pixels)
        return self._course(times), self._course(times, 1)

    def nearest(self, times: np.ndarray) -> np.ndarray:
        """Return the indices (M,) of the detections that are nearest to the times (M,), in seconds."""
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
        """Return `sigmas` (M, 21, 2), in pixels, at the times (M,) in seconds; infinite where there is no
        detection near."""
        return np.where(self.seen_at(times)[:, None, None], self.sigmas[self.nearest(times)], np.inf)

    def in_second_view(
        self, plain: Observation, sigmas: np.ndarray, moments: np.ndarray, camera: PlacedCamera
    ) -> Observation:
        """Add to the first view's observation `plain` of M hands what this view saw of them through `camera`
        at `moments` (M,), in seconds. Where both views see the hand, points count with the first view's
        `sigmas` (M, 21, 2), in pixels, and depth counts less."""
        saw, (pixels, _) = self.seen_at(moments)[:, None], self.at(moments)
        return replace(
            plain,
            pixel_sigma=np.where(saw[..., None], sigmas, plain.pixel_sigma),
            depth_sigma=plain.depth_sigma * np.where(saw, VIEWS.fit_depth_factor, 1.0),
            second=SecondView.through(camera, pixels, self.sigmas_at(moments)),
        )
