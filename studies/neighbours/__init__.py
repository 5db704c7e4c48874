"""The paper's method compared with its neighbours, at an equal budget of simulated cycles.

`methods` defines what a decision is in each method, `decisions` and `absolute` make tasks with such
decisions, `learner` trains with PPO and `temporl` with Q-learning, `flights` evaluates, and
`compare` trains and evaluates all methods and makes the tables. The package is also a command.
"""
