"""The noise of a gyroscope at rest: Allan deviation, and the terms that explain it."""
