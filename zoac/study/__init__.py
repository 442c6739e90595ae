"""Studies: experiments that something else runs, proposed and judged by the tuners of zoac."""
