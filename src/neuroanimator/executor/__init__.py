"""Work spread over processes or a cluster: the same results from either, for any number of workers.

tasks (frozen dataclasses), and one importable function of one task    executor.py
  → pickled, and given to a free worker                                 local.py (processes), ray_cluster.py (Ray)
  → the worker limits its threads, imports, and computes function(task) worker.py
  → the result comes back as it is ready, or the task's own error in one line
  → an error for a task whose worker died; Ray computes it again first   executor.py
"""
