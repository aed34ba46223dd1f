"""Recognising places after drift, and closing the loops: propose, verify, decide late, merge."""
