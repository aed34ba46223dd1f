"""Measurements of the whole system on simulations and recordings; printing is the command line's."""
