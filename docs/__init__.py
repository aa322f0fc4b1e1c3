"""The documentation: the pages, and in ``docs.site`` the program that builds a site of them."""
