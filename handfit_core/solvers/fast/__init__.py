"""The fast solver: batched Levenberg-Marquardt over rotations, shape and place. docs/method.md explains it."""
