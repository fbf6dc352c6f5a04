"""The command line by ``python -m clradar``, whatever files lie in the current folder."""

from clradar.cli import leave_current_folder, main

if __name__ == "__main__":
    leave_current_folder()
    main()
