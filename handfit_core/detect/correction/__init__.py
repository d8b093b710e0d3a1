"""Correction of the detector's landmarks: where it errs, how much, and when it names the wrong side.

One small network (`network`), trained by scripts/train_landmarks.py on painted pictures of the open hand
only. docs/method.md has its training data and its gain.
"""
