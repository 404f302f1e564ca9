"""Floor plans, a simulated robot, and the log, truth and reference map it leaves."""
