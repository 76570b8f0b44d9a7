"""One small file per way to run a recursion; each offers `build(plan) -> run(arrays, theta, start, stop)`.

`arrays` holds the states and then the inputs in the plan's order, `theta` the parameters. `run` writes the states
in place for start <= k < stop and returns the first index whose value is not finite, or stop.
"""
