# The part of ReportLab that this project uses; the library has no types. tests/test_stubs.py compares it.
