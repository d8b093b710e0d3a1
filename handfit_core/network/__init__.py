"""What talks to other programs through the network, and only where a user's command says so.

Nothing else of the core opens a socket, nothing else imports this, and the add-on's zip does not have it
(SECURITY.md).
"""
