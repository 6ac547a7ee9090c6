"""Observers: from measured motion to the states and forces behind it, one method a file."""
