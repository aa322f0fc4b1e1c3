"""Metrics of running robots for Prometheus, in the OpenMetrics format.

They are computed from the telemetry on the mesh, in a separate process. A scrape asks nothing of the robot.

``ledger``     counts and histograms of each robot, from its samples; pure
``families``   the metrics with their names and labels
``stops``      the stops of all robots, from the same samples; pure
``traces``     shows stops as OpenTelemetry traces
``serving``    joins the mesh, and serves the metrics over HTTP
"""
