"""What a user holds: ``Robot`` and its kinds, with verbs that return envelopes."""
