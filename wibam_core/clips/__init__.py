"""Video clips of a job's results: the plan and all cameras' views in step, with the road users drawn in."""
