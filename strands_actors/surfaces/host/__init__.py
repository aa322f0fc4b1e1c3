"""The host: one process that keeps the robots of this computer, for scripts that come and go.

``toml_lines``   the line of each key of a TOML file; pure
``fleet``        the robots as the file describes them, and the faults of the file
``fleet_file``   reads the file of the host, and finds all its faults
``adapters``     which USB adapter each robot had, so that swapped cables are noticed
``keeper``       starts one robot, and starts it again
``host``         keeps all robots, and obeys orders
``orders``       the orders, from another process
``notify``       tells systemd that the host is ready, and alive
``install``      the texts of the systemd unit and the udev rules
"""
