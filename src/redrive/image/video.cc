// SPDX-License-Identifier: Apache-2.0
#include "redrive/image/video.h"

#include "redrive/base/error.h"
#include "redrive/base/files/unfinished.h"

#ifdef REDRIVE_VIDEO

#include <cmath>
#include <cstring>

#include <dlfcn.h>

extern "C" {
#include <libavcodec/avcodec.h>
#include <libavformat/avformat.h>
#include <libavutil/opt.h>
#include <libswscale/swscale.h>
}

namespace redrive {
namespace {

/// The functions in use, with FFmpeg's own names and types.
struct FFmpeg {
  std::optional<std::string> obstacle;

#define REDRIVE_FFMPEG(library, version, name) \
  decltype(&::name) name = load<decltype(&::name)>("lib" #library ".so.", version, #name);
#define REDRIVE_AVFORMAT(name) REDRIVE_FFMPEG(avformat, LIBAVFORMAT_VERSION_MAJOR, name)
#define REDRIVE_AVCODEC(name) REDRIVE_FFMPEG(avcodec, LIBAVCODEC_VERSION_MAJOR, name)
#define REDRIVE_AVUTIL(name) REDRIVE_FFMPEG(avutil, LIBAVUTIL_VERSION_MAJOR, name)
#define REDRIVE_SWSCALE(name) REDRIVE_FFMPEG(swscale, LIBSWSCALE_VERSION_MAJOR, name)
  REDRIVE_AVFORMAT(avformat_alloc_output_context2)
  REDRIVE_AVFORMAT(avformat_new_stream)
  REDRIVE_AVFORMAT(avformat_write_header)
  REDRIVE_AVFORMAT(avformat_free_context)
  REDRIVE_AVFORMAT(av_interleaved_write_frame)
  REDRIVE_AVFORMAT(av_write_trailer)
  REDRIVE_AVFORMAT(avio_open)
  REDRIVE_AVFORMAT(avio_closep)
  REDRIVE_AVCODEC(avcodec_find_encoder_by_name)
  REDRIVE_AVCODEC(avcodec_alloc_context3)
  REDRIVE_AVCODEC(avcodec_open2)
  REDRIVE_AVCODEC(avcodec_free_context)
  REDRIVE_AVCODEC(avcodec_parameters_from_context)
  REDRIVE_AVCODEC(avcodec_send_frame)
  REDRIVE_AVCODEC(avcodec_receive_packet)
  REDRIVE_AVCODEC(av_packet_alloc)
  REDRIVE_AVCODEC(av_packet_free)
  REDRIVE_AVCODEC(av_packet_rescale_ts)
  REDRIVE_AVUTIL(av_frame_alloc)
  REDRIVE_AVUTIL(av_frame_get_buffer)
  REDRIVE_AVUTIL(av_frame_make_writable)
  REDRIVE_AVUTIL(av_frame_free)
  REDRIVE_AVUTIL(av_opt_set)
  REDRIVE_AVUTIL(av_dict_set)
  REDRIVE_AVUTIL(av_dict_free)
  REDRIVE_AVUTIL(av_strerror)
  REDRIVE_AVUTIL(av_log_set_level)
  REDRIVE_SWSCALE(sws_getContext)
  REDRIVE_SWSCALE(sws_getCoefficients)
  REDRIVE_SWSCALE(sws_setColorspaceDetails)
  REDRIVE_SWSCALE(sws_scale)
  REDRIVE_SWSCALE(sws_freeContext)

  FFmpeg() {
    if (obstacle) return;
    av_log_set_level(AV_LOG_FATAL);
    if (!avcodec_find_encoder_by_name("libx264")) obstacle = "libavcodec has no libx264";
  }

 private:
  template <class Function>
  Function load(const char* stem, int version, const char* name) {
    const std::string file = stem + std::to_string(version);
    void* const library = dlopen(file.c_str(), RTLD_NOW | RTLD_LOCAL);
    if (!library) {
      if (!obstacle) obstacle = std::string(dlerror());
      return nullptr;
    }
    void* const symbol = dlsym(library, name);
    if (!symbol && !obstacle) obstacle = file + " has no " + name;
    return reinterpret_cast<Function>(symbol);
  }
};

/// Loaded once and never unloaded.
const FFmpeg& ffmpeg() {
  static const FFmpeg functions;
  return functions;
}

}  // namespace

std::optional<std::string> video_obstacle() { return ffmpeg().obstacle; }

struct VideoWriter::Impl {
  explicit Impl(const std::filesystem::path& path) : file(path), unfinished(path) {}

  std::filesystem::path file;
  UnfinishedFile unfinished;  ///< FFmpeg opens it by its name
  AVFormatContext* format = nullptr;
  AVStream* stream = nullptr;
  AVCodecContext* codec = nullptr;
  AVFrame* frame = nullptr;
  AVPacket* packet = nullptr;
  SwsContext* scaler = nullptr;
  std::int64_t images = 0;

  ~Impl() {
    const FFmpeg& ff = ffmpeg();
    ff.sws_freeContext(scaler);
    ff.av_packet_free(&packet);
    ff.av_frame_free(&frame);
    ff.avcodec_free_context(&codec);
    if (format) ff.avio_closep(&format->pb);
    ff.avformat_free_context(format);
  }

  /// Throws where FFmpeg returned an error.
  void check(int code, const char* what) const {
    if (code >= 0) return;
    char reason[AV_ERROR_MAX_STRING_SIZE] = "";
    ffmpeg().av_strerror(code, reason, sizeof(reason));
    throw IoError(file, std::string("cannot ") + what + ": " + reason);
  }

  /// Encodes a frame, or with null the frames that the encoder still holds, and writes finished
  /// packets.
  void encode(const AVFrame* next) {
    const FFmpeg& ff = ffmpeg();
    check(ff.avcodec_send_frame(codec, next), "encode");
    while (true) {
      const int code = ff.avcodec_receive_packet(codec, packet);
      if (code == AVERROR(EAGAIN) || code == AVERROR_EOF) return;
      check(code, "encode");
      packet->stream_index = stream->index;
      packet->duration = 1;
      ff.av_packet_rescale_ts(packet, codec->time_base, stream->time_base);
      check(ff.av_interleaved_write_frame(format, packet), "write");
      check(format->pb->error, "write");
    }
  }
};

VideoWriter::VideoWriter(const std::filesystem::path& file, int width, int height, double fps)
    : impl_(std::make_unique<Impl>(file)) {
  REDRIVE_CHECK(!video_obstacle());
  REDRIVE_CHECK_OP(width, >=, 2);
  REDRIVE_CHECK_OP(height, >=, 2);
  REDRIVE_CHECK(fps >= 1 && fps <= 240);
  const FFmpeg& ff = ffmpeg();
  Impl& video = *impl_;
  const std::string url = "file:" + video.unfinished.path().string();  // ':' in it is no protocol
  video.check(ff.avformat_alloc_output_context2(&video.format, nullptr, "mp4", url.c_str()),
              "write MP4");
  video.check(ff.avio_open(&video.format->pb, url.c_str(), AVIO_FLAG_WRITE), "create");

  const AVCodec* const encoder = ff.avcodec_find_encoder_by_name("libx264");
  video.codec = ff.avcodec_alloc_context3(encoder);
  video.stream = ff.avformat_new_stream(video.format, nullptr);
  video.frame = ff.av_frame_alloc();
  video.packet = ff.av_packet_alloc();
  if (!video.codec || !video.stream || !video.frame || !video.packet) throw std::bad_alloc();
  AVCodecContext& codec = *video.codec;
  codec.width = width / 2 * 2;
  codec.height = height / 2 * 2;
  codec.framerate = {static_cast<int>(std::lround(1000 * fps)), 1000};
  codec.time_base = {codec.framerate.den, codec.framerate.num};
  codec.pix_fmt = AV_PIX_FMT_YUV420P;
  codec.color_range = AVCOL_RANGE_MPEG;
  codec.colorspace = AVCOL_SPC_BT709;
  codec.color_primaries = AVCOL_PRI_BT709;
  codec.color_trc = AVCOL_TRC_BT709;
  codec.flags |= AV_CODEC_FLAG_GLOBAL_HEADER;
  video.check(ff.av_opt_set(codec.priv_data, "crf", "18", 0), "set the quality");
  video.check(ff.avcodec_open2(&codec, encoder, nullptr), "start libx264");
  video.stream->time_base = codec.time_base;
  video.stream->avg_frame_rate = codec.framerate;
  video.check(ff.avcodec_parameters_from_context(video.stream->codecpar, &codec), "write MP4");
  AVDictionary* options = nullptr;
  ff.av_dict_set(&options, "movflags", "+faststart", 0);  // the index first: plays while it loads
  const int code = ff.avformat_write_header(video.format, &options);
  ff.av_dict_free(&options);
  video.check(code, "write");

  video.frame->format = codec.pix_fmt;
  video.frame->width = codec.width;
  video.frame->height = codec.height;
  video.check(ff.av_frame_get_buffer(video.frame, 0), "take memory");
  video.scaler = ff.sws_getContext(
      codec.width, codec.height, AV_PIX_FMT_RGB24, codec.width, codec.height, codec.pix_fmt,
      SWS_BICUBIC | SWS_ACCURATE_RND | SWS_FULL_CHR_H_INP, nullptr, nullptr, nullptr);
  if (!video.scaler) throw std::bad_alloc();
  const int* const bt709 = ff.sws_getCoefficients(SWS_CS_ITU709);
  ff.sws_setColorspaceDetails(video.scaler, bt709, 1, bt709, 0, 0, 1 << 16, 1 << 16);
}

VideoWriter::~VideoWriter() = default;

void VideoWriter::add(const Image8& image) {
  const FFmpeg& ff = ffmpeg();
  Impl& video = *impl_;
  REDRIVE_CHECK_OP(image.width / 2 * 2, ==, video.codec->width);
  REDRIVE_CHECK_OP(image.height / 2 * 2, ==, video.codec->height);
  video.check(ff.av_frame_make_writable(video.frame), "take memory");
  const std::uint8_t* const rows[] = {image.rgb.data()};
  const int stride[] = {3 * image.width};
  ff.sws_scale(video.scaler, rows, stride, 0, video.codec->height, video.frame->data,
               video.frame->linesize);
  video.frame->pts = video.images++;
  video.encode(video.frame);
}

void VideoWriter::finish() {
  const FFmpeg& ff = ffmpeg();
  Impl& video = *impl_;
  video.encode(nullptr);
  video.check(ff.av_write_trailer(video.format), "write");
  video.check(video.format->pb->error, "write");
  video.check(ff.avio_closep(&video.format->pb), "close");
  video.unfinished.finish();
}

}  // namespace redrive

#else  // REDRIVE_VIDEO

namespace redrive {

std::optional<std::string> video_obstacle() {
  return "this program was built without libavformat-dev, libavcodec-dev and libswscale-dev";
}

struct VideoWriter::Impl {};
VideoWriter::VideoWriter(const std::filesystem::path&, int, int, double) {
  REDRIVE_CHECK(!video_obstacle());
}
VideoWriter::~VideoWriter() = default;
void VideoWriter::add(const Image8&) {}
void VideoWriter::finish() {}

}  // namespace redrive

#endif  // REDRIVE_VIDEO
