"""Files to plain arrays and back, one module per format; foreign files are checked, then read by a child process."""
