"""Several instances of the service on one PostgreSQL database: who owns which link, vehicle and job.

Whatever is done for a vehicle is done by the instance that holds its lease. A lease ends by the database's clock
unless it is renewed; then another instance takes over, opens the link and finishes what the journal says. Every
transaction of a job checks the lease inside itself, so a stalled owner can store nothing once it has lost its lease.
"""
