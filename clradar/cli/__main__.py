from clradar.cli import main

main()
