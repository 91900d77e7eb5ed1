# The part of imageio that this project uses; the library's own types are incomplete. tests/test_stubs.py compares it
# with the library.
