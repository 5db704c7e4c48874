"""Evaluation of controllers: rollouts, tables, statistics, comparison with the paper."""
