"""The factor graph and its solver. GTSAM is used only in this package."""
