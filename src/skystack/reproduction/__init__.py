"""Reproduce the paper: train, judge and compare, a piece at a time, none of them twice."""
