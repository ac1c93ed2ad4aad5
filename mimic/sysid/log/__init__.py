"""Logs: which samples count, when targets were sent, what is wrong with them."""
