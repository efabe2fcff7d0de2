"""The accelerometer: poses in any direction, six faces on a fixture, one pose at rest."""
