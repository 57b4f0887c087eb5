// SPDX-License-Identifier: MIT
// A memory that the host fills with one stream of bits and the pipeline takes rows from, in order.
//
// Words wait in a queue between the memory and the unpacker, and one is read when there is a place for it
// there: whether the memory is read so depends on a flag alone, however far away the unpacker is.
// Host and pipeline share the read port: the host is served only while busy_i is low.
module pearl_input_bank
  import pearl_pkg::*;
#(
    parameter int unsigned ROW_BITS = 48,
    parameter int unsigned DATA_WL = 32,
    parameter int unsigned WORDS = 3,
    localparam int unsigned ADDR_BITS = index_bits(WORDS)
) (
    input  logic                clk_i,
    input  logic                rst_ni,
    input  logic                busy_i,
    // Starts over at the first word.
    input  logic                start_i,
    output logic                valid_o,
    output logic [ROW_BITS-1:0] row_o,
    input  logic                take_i,

    input  logic                 host_re_i,
    input  logic                 host_we_i,
    input  logic [ADDR_BITS-1:0] host_addr_i,
    input  logic [  DATA_WL-1:0] host_wdata_i,
    output logic [  DATA_WL-1:0] host_rdata_o
);

  // As many places as cycles from when one gets free to when the word that was read for it is in it.
  localparam int unsigned PLACES = READ_LATENCY + 2;
  localparam int unsigned PLACE_BITS = $clog2(PLACES + 1);

  logic re, active_q, place_q, ended_q, row_valid, row_ready;
  logic came_valid, came_ready, came_taken, word_valid, word_ready;
  logic [DATA_WL-1:0] came, word;
  logic [ROW_BITS-1:0] row;
  logic [$clog2(WORDS+1)-1:0] count_q;
  logic [READ_LATENCY-1:0] coming_q;
  // Places that are neither taken nor promised to a word on its way.
  logic [PLACE_BITS-1:0] places_d, places_q;

  assign re = active_q && place_q;
  assign came_taken = came_valid && came_ready;
  assign places_d = places_q + PLACE_BITS'(came_taken) - PLACE_BITS'(re);

  always_ff @(posedge clk_i) begin
    if (!rst_ni || start_i) begin
      active_q <= start_i && rst_ni;
      ended_q  <= 1'b0;
      coming_q <= '0;
      place_q  <= 1'b1;
      places_q <= PLACE_BITS'(PLACES);
      count_q  <= '0;
    end else begin
      if (re) begin
        count_q  <= count_q + 1'b1;
        active_q <= 32'(count_q) != WORDS - 1;
      end
      coming_q <= READ_LATENCY'({coming_q, re});
      place_q  <= places_d != '0;
      places_q <= places_d;
      ended_q  <= !active_q && 32'(places_q) == PLACES && !word_valid;
    end
  end

  pearl_ram #(
      .WIDTH(DATA_WL),
      .DEPTH(WORDS)
  ) u_ram (
      .clk_i,
      .we_i   (host_we_i),
      .waddr_i(host_addr_i),
      .wdata_i(host_wdata_i),
      .re_i   (busy_i ? re : host_re_i),
      .raddr_i(busy_i ? count_q[ADDR_BITS-1:0] : host_addr_i),
      .rdata_o(host_rdata_o)
  );

  pearl_fifo #(
      .WIDTH(DATA_WL),
      .DEPTH(PLACES)
  ) u_places (
      .clk_i,
      .rst_ni (rst_ni && !start_i),
      .push_i (coming_q[READ_LATENCY-1]),
      .data_i (host_rdata_o),
      .valid_o(came_valid),
      .data_o (came),
      .pop_i  (came_taken)
  );

  // Between choosing a place and shifting its word to where it belongs in a row.
  pearl_slice #(
      .WIDTH(DATA_WL)
  ) u_words (
      .clk_i,
      .rst_ni (rst_ni && !start_i),
      .valid_i(came_valid),
      .ready_o(came_ready),
      .data_i (came),
      .valid_o(word_valid),
      .ready_i(word_ready),
      .data_o (word)
  );

  pearl_unpacker #(
      .ROW_BITS(ROW_BITS),
      .DATA_WL (DATA_WL)
  ) u_unpacker (
      .clk_i,
      .rst_ni (rst_ni && !start_i),
      .valid_i(word_valid),
      .ready_o(word_ready),
      .word_i (word),
      .end_i  (ended_q),
      .valid_o(row_valid),
      .ready_i(row_ready),
      .row_o  (row)
  );

  pearl_slice #(
      .WIDTH(ROW_BITS)
  ) u_rows (
      .clk_i,
      .rst_ni (rst_ni && !start_i),
      .valid_i(row_valid),
      .ready_o(row_ready),
      .data_i (row),
      .valid_o(valid_o),
      .ready_i(take_i),
      .data_o (row_o)
  );

  always_ff @(posedge clk_i) begin
    if (rst_ni) begin
      assert (valid_o || !take_i)
      else $error("pearl_input_bank: a row was taken that is not there");
    end
  end

endmodule
