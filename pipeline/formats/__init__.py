"""Files of other programs as plain arrays: what they claim is checked, then a child process reads them."""
