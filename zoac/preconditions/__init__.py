"""What must hold of a task before it is tuned."""
