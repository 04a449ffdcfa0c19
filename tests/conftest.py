"""Makes tests/combinations.py importable from every folder of tests: pytest puts this file's folder on the path."""
