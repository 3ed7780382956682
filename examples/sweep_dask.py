"""Four simulations by two processes of Dask: `pip install . "dask[distributed]"`. Workers on other machines need softarm too."""

from dask.distributed import Client, LocalCluster

import softarm as sa

if __name__ == "__main__":
    tasks = [{"verb": "simulate", "scene": "swing", "set": {"rod.elements": n, "time.end_s": 0.2}} for n in (4, 6, 8, 10)]
    with LocalCluster(n_workers=2, threads_per_worker=1, dashboard_address=None) as cluster, Client(cluster) as client:
        for task, done in zip(tasks, client.gather(client.map(sa.run, tasks))):
            print(f"{task['set']['rod.elements']} elements: tip at {done['summary']['tip']['position_m']} m")
