"""What everything else is written in: parameters, tasks, segments, tuners."""
