#!/bin/bash
#SBATCH --array=1-8
#SBATCH --cpus-per-task=4
#SBATCH --mem=10G
#SBATCH --time=04:00:00
hiermap batch nightly.yaml -o nightly --shard "$SLURM_ARRAY_TASK_ID/8" --workers 4 --memory-limit 2GB -q
