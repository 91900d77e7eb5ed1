# The part of imageio-ffmpeg that this project uses; the library's own types are incomplete. tests/test_stubs.py
# compares it with the library.

def get_ffmpeg_exe() -> str: ...
