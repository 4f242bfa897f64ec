"""Files to plain arrays and back, a module a format; foreign files are checked, then read by a child process."""
