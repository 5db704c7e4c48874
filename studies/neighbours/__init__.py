"""The paper's method compared with its neighbours, at an equal budget of simulated cycles.

`methods` defines what a decision is in each method, `decisions` and `absolute` turn a task into
one of such decisions, `learner` trains with PPO, `temporl` with Q-learning, `flights` evaluates,
and `compare` does both for everything and makes the tables. The package is also the command.
"""
