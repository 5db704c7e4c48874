"""How controllers are judged: rollouts, tables, statistics, comparison with the paper."""
