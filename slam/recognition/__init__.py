"""Recognise a drive from an unknown start in a known map or plan, by the evidence of all its submaps."""
