"""Parts of benchmarks/robustness.py, shared with its short versions among the tests."""
