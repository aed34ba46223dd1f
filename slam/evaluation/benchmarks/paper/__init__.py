"""Test the claims of the WCLM paper (Prieto-Fernández et al. 2023); run by `wclm bench paper`."""
