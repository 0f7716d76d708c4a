"""docs/images/mic_512.webp: the same view as filmed, magnified by tg4mm, and as the truth.

tg4mm generate mic --out sets --size 512 --views 14 --samples 24 --alphas 50 --test-views 1 --truth none
tg4mm train sets/mic_5Hz_0_005 --out runs/mic512
tg4mm render runs/mic512 --alpha 50 --band auto --out x50
python docs/images/mic_512.py sets/mic_5Hz_0_005 x50
"""

import sys
from pathlib import Path

from PIL import Image, ImageDraw, ImageFont

SIZE, STEPS, REPEATS = 320, 6, 1  # a vibration of 5 Hz at 30 frames a second is six timesteps long
LABELS = ("as filmed", "magnified 51 times", "truth")
CROP = (96, 0, 416, 320)  # of the picture of 512×512: the microphone


def main(dataset: Path, magnified: Path) -> None:
    """Writes the picture beside this file."""
    font = ImageFont.load_default(size=15)
    frames = []
    for t in range(STEPS):
        sources = (
            dataset / f"{t:03}/test/r_000.png",
            magnified / f"{t:03}/r_000.png",
            dataset / f"magnified/x050/{t:03}/test/r_000.png",
        )
        frame = Image.new("RGB", (3 * SIZE + 16, SIZE + 26), "white")
        draw = ImageDraw.Draw(frame)
        for i, (path, label) in enumerate(zip(sources, LABELS, strict=True)):
            picture = Image.open(path).convert("RGBA")
            white = Image.new("RGBA", picture.size, "white")
            picture = Image.alpha_composite(white, picture).convert("RGB").crop(CROP)
            frame.paste(picture.resize((SIZE, SIZE), Image.Resampling.LANCZOS), (i * (SIZE + 8), 26))
            draw.text((i * (SIZE + 8) + 4, 4), label, fill="black", font=font)
        frames.append(frame)
    out = Path(__file__).with_suffix(".webp")
    frames[0].save(out, save_all=True, append_images=frames[1:], duration=110, loop=0, quality=82, method=6)


if __name__ == "__main__":
    main(Path(sys.argv[1]), Path(sys.argv[2]))
