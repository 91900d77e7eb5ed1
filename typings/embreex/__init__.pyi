# The part of embreex that this project uses; the wheel ships no types. tests/test_stubs.py compares it with the
# library.
