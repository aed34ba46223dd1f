"""The claims of the WCLM paper (Prieto-Fernández et al. 2023), each tested: what `wclm bench paper` runs."""
