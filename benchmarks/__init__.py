"""One folder a claim: its scripts, their cases and the tables they wrote; its page is under docs. Run from the root:

python -m benchmarks.equal_error.table1 --quick
"""
