"""Measurements that anyone can repeat: what `wclm bench` runs."""
