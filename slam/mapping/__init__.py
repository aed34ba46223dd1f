"""The landmark map: data association, keyframes, merging and removal of walls. Other packages only read it."""
