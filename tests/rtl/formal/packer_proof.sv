// SPDX-License-Identifier: MIT
// No bit is lost, doubled or moved between the rows that go into a packer and the words it writes,
// whenever rows come and however long they take.
module packer_proof #(
    parameter int unsigned ROW_BITS = 6,
    parameter int unsigned DATA_WL = 4,
    parameter int unsigned ROWS = 3,
    parameter int unsigned WORDS = 4,
    localparam int unsigned ADDR_BITS = pearl_pkg::index_bits(WORDS)
) (
    input logic                clk_i,
    input logic                start_i,
    input logic                valid_i,
    input logic [ROW_BITS-1:0] row_i
);

  localparam int unsigned STREAM_BITS = ROWS * ROW_BITS + DATA_WL;
  localparam int unsigned UNIT = pearl_pkg::common_unit(ROW_BITS, DATA_WL);

  logic rst_nq = 1'b0;
  always_ff @(posedge clk_i) rst_nq <= 1'b1;

  logic last, we, done;
  logic [ADDR_BITS-1:0] waddr;
  logic [  DATA_WL-1:0] wdata;

  pearl_packer #(
      .ROW_BITS(ROW_BITS),
      .DATA_WL (DATA_WL),
      .WORDS   (WORDS)
  ) u_packer (
      .clk_i,
      .rst_ni (rst_nq),
      .start_i,
      .valid_i,
      .last_i (last),
      .row_i,
      .we_o   (we),
      .waddr_o(waddr),
      .wdata_o(wdata),
      .done_o (done)
  );

  // What went in, and how many words came out.
  logic started_q;
  logic [31:0] rows_q, words_q;
  logic [STREAM_BITS-1:0] stream_q;
  assign last = rows_q == ROWS - 1;

  always_ff @(posedge clk_i) begin
    if (!rst_nq) begin
      started_q <= 1'b0;
      rows_q <= '0;
      words_q <= '0;
      stream_q <= '0;
    end else if (start_i) begin
      started_q <= 1'b1;
      rows_q <= '0;
      words_q <= '0;
      stream_q <= '0;
    end else begin
      if (valid_i) begin
        stream_q <= stream_q | (STREAM_BITS'(row_i) << (rows_q * ROW_BITS));
        rows_q   <= rows_q + 1;
      end
      if (we) words_q <= words_q + 1;
    end
  end

  // The contract: rows come after a start, no more than there are, and when there is room.
  always_comb begin
    if (valid_i) begin
      assume (rst_nq && started_q && !start_i && rows_q < ROWS);
      assume (u_packer.room);
    end
  end

  always_ff @(posedge clk_i) begin
    if (rst_nq) begin
      if (we) begin
        assert (32'(waddr) == words_q && words_q < WORDS);
        assert (wdata == DATA_WL'(stream_q >> (words_q * DATA_WL)));
        // It is full, but for the last one.
        assert ((words_q + 1) * DATA_WL <= rows_q * ROW_BITS || rows_q == ROWS);
      end
      assert (done == (words_q == WORDS));
      // A row that came in time is never stuck: after the last one there is a word in every cycle.
      if (started_q && rows_q == ROWS && !done) assert (we);
`ifndef PROPERTY_ONLY
      // What makes the above inductive.
      assert (32'(u_packer.count_q) == words_q && words_q <= WORDS && rows_q <= ROWS);
      assert (u_packer.last_q == (rows_q == ROWS));
      assert (started_q || (rows_q == 0 && words_q == 0 && 32'(u_packer.u_fill.fill_q) == 0));
      assert (u_packer.u_fill.word_q == (32'(u_packer.u_fill.fill_q) >= DATA_WL / UNIT));
      assert (u_packer.u_fill.room_q == (32'(u_packer.u_fill.fill_q) < 2 * DATA_WL / UNIT));
      if (!done && started_q) begin
        assert (32'(u_packer.u_fill.fill_q) * UNIT == rows_q * ROW_BITS - words_q * DATA_WL);
        assert (rows_q * ROW_BITS - words_q * DATA_WL <= ROW_BITS + DATA_WL);
        assert (u_packer.acc_q == (ROW_BITS + DATA_WL)'(stream_q >> (words_q * DATA_WL)));
        assert (stream_q >> (rows_q * ROW_BITS) == '0);
      end
`endif
    end
  end

endmodule
