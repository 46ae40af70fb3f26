"""stub"""
def planned_table(reproduction):
    rows=[]
    for s in reproduction.stages:
        rows.append(f"{'done' if reproduction.workplace.is_done(s) else 'to do':<6} {s.key} {' '.join(s.command(reproduction.workplace.root))[:250]}\n")
    return ''.join(rows)
def write_report(a,b): return 'none'
