"""The fast solver: batched Levenberg-Marquardt over rotations, shape and place; see docs/method.md."""
