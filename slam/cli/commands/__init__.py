"""The commands of `wclm`, one module each; helpers of one command share its prefix.

Commands import what they need when they are called, so that `wclm --help` answers at once.
"""
