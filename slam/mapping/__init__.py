"""Build and maintain the landmark map: data association, keyframes, wall merging and removal."""
